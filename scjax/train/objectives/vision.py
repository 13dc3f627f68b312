"""The vision network that comes with scjax, trained to say what the cells of rendered pictures show."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.camera.dashcam.materials import SemanticClass
from scjax.encoders.dashcam_network import PLACE_SCALE, DashcamConfig
from scjax.encoders.dashcam_weights import MODEL_TYPE, NETWORK, DashcamWeights, dashcam_functions
from scjax.encoders.image_network import load_network
from scjax.nn.functional import Functional, Params
from scjax.nn.functional import Path as ParamPath
from scjax.train.objectives.base import PicturePath, Terms
from scjax.train.picture_loader import (
    PictureExample,
    PictureLoader,
    PictureLoaderConfig,
    picture_rows,
)
from scjax.train.resume import params_hash

_VALIDATION_BATCHES = 16
_OBJECT_SCALES = (1 / PLACE_SCALE, 1 / PLACE_SCALE, 1.0, 1.0, 0.1, 0.1)
_LANE_SCALES = (1 / PLACE_SCALE, 1 / PLACE_SCALE, 1.0, 1.0, 0.25)
_NEAR = 30.0  # m; errors of what is farther away count less, in proportion
_SAME = 0.05  # m within which two cells show the same object or point of a lane


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class VisionObjective:
    """See ``Objective``.

    Attributes:
      pictures: folder of rendered pictures.
      model: sizes of the network.
      loader: what batches look like.
      weights: of the classes, depth, objects and lanes in the loss.
      start: parameters of step 0, or None for fresh ones.
    """

    pictures: str
    model: DashcamConfig
    loader: PictureLoaderConfig
    weights: tuple[float, float, float, float]
    start: Params | None = None

    frozen: ClassVar[frozenset[ParamPath]] = frozenset()

    @classmethod
    def from_config(cls, config) -> VisionObjective:
        """The objective of a training config.

        Raises:
          ValueError: there are no pictures, or the network of ``init_from`` cannot be read or has other sizes.
        """
        picture_rows(config.pictures, "train")
        model, start = DashcamConfig(**config.model.to_dict()), None
        if config.init_from:
            loaded = load_network(Path(config.init_from), {MODEL_TYPE: NETWORK}, model.compute)
            if loaded.config != model:
                raise ValueError(f"config.init_from: {config.init_from} has other sizes: give its config.model")
            start = loaded.params
        return cls(
            pictures=config.pictures,
            model=model,
            start=start,
            loader=PictureLoaderConfig(**config.batch.to_dict()),
            weights=(config.loss.classes, config.loss.depth, config.loss.objects, config.loss.lanes),
        )

    @property
    def network(self) -> Functional:
        """The vision network as pure functions."""
        return dashcam_functions(self.model)

    @property
    def inputs(self) -> dict[str, str]:
        """A hash of the names of the pictures."""
        rows = np.array(picture_rows(self.pictures, "train"))
        start = {} if self.start is None else {"init_from": params_hash(self.start)}
        return {"pictures": hashlib.sha256(rows.tobytes()).hexdigest(), **start}

    def batches(self, loader: PictureLoaderConfig, *, process: int = 0, processes: int = 1) -> PictureLoader:
        """Endless batches of training pictures."""
        return PictureLoader(self.pictures, "train", loader, process=process, processes=processes)

    def init(self, key: Array) -> Params:
        """Fresh parameters, or those of ``start``."""
        return self.network.init(key) if self.start is None else jax.tree.map(jnp.asarray, self.start)

    def prepare(self, params: Params) -> Params:
        """Nothing is fitted beforehand."""
        return params

    def loss(self, params: Params, batch: PictureExample, keys: Array) -> tuple[Array, Terms]:
        """Cross-entropy of classes and of being there; absolute errors of the logarithm of depth and of places."""
        cells = self.network.apply(params, jnp.asarray(batch.pixels), method="cells")
        shares = jnp.asarray(batch.classes, jnp.float32) / 255
        classes = -(shares * jax.nn.log_softmax(cells.classes, -1)).sum(-1).mean()
        depth = jnp.abs(cells.depth - jnp.log(jnp.asarray(batch.depth))).mean()
        objects, has_object = _found(cells.objects, jnp.asarray(batch.objects), _OBJECT_SCALES)
        lanes, has_lane = _found(cells.lanes, jnp.asarray(batch.lanes), _LANE_SCALES)
        terms = {"classes": classes, "depth": depth, "objects": objects + has_object, "lanes": lanes + has_lane}
        loss = sum(weight * term for weight, term in zip(self.weights, terms.values(), strict=True))
        return jnp.asarray(loss), {**terms, "object_places": objects, "lane_places": lanes}

    def evaluate(self, params: Params) -> dict[str, float]:
        """Of validation pictures: loss terms, cells with the right class, errors of depth and of places [m]."""
        terms = [jax.device_get(self._measures(params, batch)) for batch in self._validation]
        return {name: float(np.nanmean([one[name] for one in terms])) for name in terms[0]}

    def draw_pictures(self, params: Params, path_of: PicturePath) -> None:
        """The network has numbers only."""

    def export(self, params: Params, notes: dict[str, Any]) -> DashcamWeights:
        """The weights, as a folder that ``load_image_encoder`` and ``load_depth_network`` read."""
        return DashcamWeights(self.model, jax.device_get(params), notes)

    @functools.cached_property
    def _validation(self) -> list[PictureExample]:
        plain = dataclasses.replace(self.loader, mirror=0.0, brightness=0.0, tint=0.0, cut=0.0)
        loader = PictureLoader(self.pictures, "val", plain)
        return [next(loader) for _ in range(min(_VALIDATION_BATCHES, max(len(loader) // plain.batch_size, 1)))]

    @functools.cached_property
    def _measures(self) -> Callable[[Params, PictureExample], Terms]:
        def measure(params: Params, batch: PictureExample) -> Terms:
            keys = jax.random.split(jax.random.key(0), 1)
            terms = self.loss(params, batch, keys)[1]
            cells = self.network.apply(params, jnp.asarray(batch.pixels), method="cells")
            classes, objects, lanes = (jnp.asarray(x) for x in (batch.classes, batch.objects, batch.lanes))
            right = cells.classes.argmax(-1) == classes.argmax(-1)
            is_sky = classes.argmax(-1) == SemanticClass.SKY
            ratio = jnp.exp(jnp.abs(cells.depth - jnp.log(jnp.asarray(batch.depth))))
            apart = jnp.hypot(*jnp.moveaxis(PLACE_SCALE * cells.objects[..., :2] - objects[..., :2], -1, 0))
            near = (objects[..., 6] > 0) & (objects[..., 0] < 40)
            across = jnp.abs(4 * cells.lanes[..., 4] - lanes[..., 4])
            return {
                **terms,
                "class_accuracy": right.mean(),
                "depth_ratio": jnp.nanmedian(jnp.where(is_sky, jnp.nan, ratio)),
                "object_error_40m": jnp.nanmedian(jnp.where(near, apart, jnp.nan)),
                "object_found": jnp.where(near, cells.objects[..., 6] > 0, False).sum() / jnp.maximum(near.sum(), 1),
                "lane_error": jnp.nanmedian(jnp.where(lanes[..., 5] > 0, across, jnp.nan)),
            }

        return jax.jit(measure)


def _found(outputs: Array, targets: Array, scales: tuple[float, ...]) -> tuple[Array, Array]:
    """Mean error of the numbers of what is there, and cross-entropy of being there."""
    there = targets[..., -1]
    errors = jnp.abs(outputs[..., :-1] - targets[..., :-1] * jnp.asarray(scales)[None, None, None])
    weight = there * _NEAR / (_NEAR + jnp.hypot(targets[..., 0], targets[..., 1])) / jnp.sqrt(_cells_of_same(targets))
    mean = (errors.sum(-1) * weight).sum() / jnp.maximum(weight.sum(), 1.0)
    logits = outputs[..., -1]
    entropy = jnp.maximum(logits, 0) - logits * there + jnp.log1p(jnp.exp(-jnp.abs(logits)))
    return mean, entropy.mean()


def _cells_of_same(targets: Array) -> Array:
    """How many cells of a picture show the object, or point of a lane, that a cell shows."""
    places = targets[..., :2].reshape(len(targets), -1, 2)
    there = targets[..., -1].reshape(len(targets), 1, -1)
    same = (jnp.abs(places[:, :, None] - places[:, None]) < _SAME).all(-1) & (there > 0)
    return jnp.maximum(same.sum(-1), 1).reshape(targets.shape[:3])
