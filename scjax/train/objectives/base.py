"""What the training loop asks of a network that it trains: the ``Objective`` protocol.

A new objective is one file with a frozen dataclass, and one line in ``scjax.train.objectives``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Array

from scjax.data.caption_features import TextStore
from scjax.data.loader import Bucket, TrainingExample, batch_of
from scjax.data.measurements import MeasuredRecords
from scjax.data.window_images import WindowImages
from scjax.generate.model import Model
from scjax.models.codec import SceneCodec
from scjax.nn.functional import Params
from scjax.nn.functional import Path as ParamPath
from scjax.nn.random import row_keys

Terms = dict[str, Array]

PicturePath = Callable[[str], Path]
"""Name of a picture -> the file to write it to."""


@runtime_checkable
class Weights(Protocol):
    """A trained network that is no part of a ``Model``."""

    def save(self, folder: str | Path) -> Path:
        """Writes the folder as a whole and returns its path."""
        ...


@runtime_checkable
class Objective(Protocol):
    """A network with its data, loss and evaluation; the loop knows nothing else of it."""

    @property
    def frozen(self) -> frozenset[ParamPath]:
        """Paths of parameters that are not trained."""
        ...

    @property
    def inputs(self) -> dict[str, str]:
        """Config field (or "captions") -> hash of the content that the run reads there."""
        ...

    def init(self, key: Array) -> Params:
        """Parameters of step 0."""
        ...

    def prepare(self, params: Params) -> Params:
        """Fits what must be fitted before step 0; not called where a run resumes."""
        ...

    def loss(self, params: Params, batch: Any, keys: Array) -> tuple[Array, Terms]:
        """Loss and its terms, means over the rows [B] of the batch; random numbers come from the keys [B]."""
        ...

    def evaluate(self, params: Params) -> dict[str, float]:
        """Numbers on the validation split."""
        ...

    def draw_pictures(self, params: Params, path_of: PicturePath) -> None:
        """Writes pictures of validation scenes."""
        ...

    def export(self, params: Params, notes: dict[str, Any]) -> Model | Weights:
        """The model or weights with these parameters; ``notes`` says how they were trained (steps, config)."""
        ...


@runtime_checkable
class StreamObjective(Objective, Protocol):
    """An objective with batches of its own."""

    def batches(self, loader: Any, *, process: int = 0, processes: int = 1) -> Any:
        """Endless batches (``train.batches.Batches``) of the training data, for one process of several."""
        ...


@runtime_checkable
class SceneObjective(Objective, Protocol):
    """An objective of which the batches are scenes of a record folder."""

    @property
    def codec(self) -> SceneCodec:
        """Types, columns and ranges of the scenes that the loader reads."""
        ...

    @property
    def texts(self) -> TextStore | None:
        """Captions of the training split that batches carry, or None."""
        ...

    @property
    def measurements(self) -> MeasuredRecords | None:
        """Attributes of the training split, of which batches carry requests, or None."""
        ...

    @property
    def ahead(self) -> MeasuredRecords | None:
        """Attributes of the forward windows of the training split, of which batches carry requests, or None."""
        ...

    @property
    def images(self) -> WindowImages | None:
        """What a camera sees in the forward windows of the training split, or None."""
        ...


def mean_terms(
    terms: Callable[[Params, TrainingExample, Array], Terms],
    params: Params,
    examples: Sequence[TrainingExample],
    *,
    batch_size: int,
    bucket: Bucket,
    key: Array,
    repeats: int = 1,
) -> dict[str, float]:
    """Means of loss terms over whole batches of examples, each seen ``repeats`` times with other random numbers.

    The last examples, fewer than a batch, are left out, unless they are all.

    Args:
      terms: (parameters, batch, keys [B]) -> means over the batch.
      examples: with an ``index``, which names an example's random numbers.
      bucket: padded shape of the batches.
    """
    results = []
    end = len(examples) - len(examples) % batch_size or len(examples)
    for repeat in range(repeats):
        for start in range(0, end, batch_size):
            batch = batch_of(examples[start : start + batch_size], bucket)
            keys = row_keys(jax.random.fold_in(key, repeat), np.asarray(batch.index))
            results.append(jax.device_get(terms(params, batch, keys)))
    return {name: float(np.mean([terms[name] for terms in results])) for name in results[0]}


def every_nth(items: Sequence[Any], number: int) -> list[Any]:
    """At most ``number`` of the items, evenly spaced."""
    return list(items[:: max(len(items) // number, 1)][:number])
