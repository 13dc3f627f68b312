"""A trained behavior in a folder: its network, its vocabulary, and how it was trained."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from msgspec import Struct

from scjax.models.behavior.config import CLASSES, BehaviorConfig
from scjax.models.behavior.network import behavior_network
from scjax.nn.functional import Params, flatten
from scjax.nn.safetensors import array_names, named_arrays, read_arrays, write_arrays
from scjax.scene.document import parse_document
from scjax.scene.files import whole_folder

DEFAULT_BEHAVIOR = Path(__file__).parents[1] / "pretrained_behavior"
"""Folder of the behavior that ships with the package."""

BEHAVIOR_FORMAT = "scjax-behavior-1"
_INDEX, _VOCABULARY = "behavior.json", "vocabulary"
_CURE = "train or copy it again"


class _Index(Struct):
    """The content of behavior.json."""

    format: str
    config: dict[str, Any]
    files: dict[str, str]
    notes: dict[str, Any] = {}


@dataclasses.dataclass(frozen=True, eq=False)
class BehaviorWeights:
    """What ``LearnedBehavior`` drives with. Equal contents are equal, so that programs compile once for them.

    Attributes:
      config: sizes of the network.
      params: its parameters.
      vocabulary: changes of motion that tokens stand for.
      notes: free JSON: training data, steps.
    """

    config: BehaviorConfig
    params: Params
    vocabulary: Float[np.ndarray, "C V 3"]
    notes: dict[str, Any] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def sha256(self) -> str:
        """Of the sizes, the parameters and the vocabulary."""
        digest = hashlib.sha256(json.dumps(dataclasses.asdict(self.config)).encode())
        for path, leaf in sorted(flatten(self.params).items(), key=lambda item: str(item[0])):
            digest.update(f"{path}{np.shape(leaf)}".encode() + np.ascontiguousarray(leaf, np.float32).tobytes())
        digest.update(np.ascontiguousarray(self.vocabulary, np.float32).tobytes())
        return digest.hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, BehaviorWeights) and self.sha256 == other.sha256

    def __hash__(self) -> int:
        return hash(self.sha256)

    def save(self, folder: str | Path, *, dtype: str | None = None) -> Path:
        """Writes the folder and returns its path. An existing one is replaced at the end, as a whole.

        Args:
          dtype: of the stored parameters; "float16" halves them.

        Raises:
          ValueError: the arrays do not fit the sizes; nothing is written.
        """
        self.check()
        arrays = array_names({"network": self.params}) | {_VOCABULARY: np.asarray(self.vocabulary, np.float32)}
        with whole_folder(Path(folder), "the behavior") as temporary:
            files = write_arrays(arrays, temporary, dtype=dtype, exact=(_VOCABULARY,))
            fields = {"format": BEHAVIOR_FORMAT, "config": dataclasses.asdict(self.config), "files": files}
            (temporary / _INDEX).write_text(json.dumps({**fields, "notes": self.notes}, indent=1, allow_nan=False))
        return Path(folder)

    def check(self) -> None:
        """Compares the arrays with the sizes.

        Raises:
          ValueError: an array is missing, too many, not finite or of another shape.
        """
        arrays = {path: np.asarray(leaf) for path, leaf in flatten(self.params).items()}
        shapes = {path: leaf.shape for path, leaf in flatten(behavior_network(self.config).shapes()).items()}
        for path in sorted({*arrays, *shapes}, key=str):
            shape = arrays[path].shape if path in arrays else "missing"
            if shape != shapes.get(path):
                name = ".".join(map(str, path))
                raise ValueError(f"the behavior: {name} is {shape}, the config calls for {shapes.get(path)}: {_CURE}")
        if self.vocabulary.shape != (CLASSES, self.config.motions, 3):
            raise ValueError(f"the behavior: the vocabulary has shape {self.vocabulary.shape}: {_CURE}")
        if not all(np.isfinite(array).all() for array in (*arrays.values(), self.vocabulary)):
            raise ValueError(f"the behavior has numbers that are not finite: {_CURE}")


def load_behavior(path: str | Path | None = None) -> BehaviorWeights:
    """Reads a folder that ``BehaviorWeights.save`` or training wrote.

    Args:
      path: the folder; None: the behavior that ships with scjax, trained on its synthetic worlds alone.

    Raises:
      ValueError: the folder is missing or damaged, or its arrays do not fit its sizes.
    """
    return _default_behavior() if path is None else _read(Path(path))


@functools.cache
def _default_behavior() -> BehaviorWeights:
    return _read(DEFAULT_BEHAVIOR)


def _read(folder: Path) -> BehaviorWeights:
    path = folder / _INDEX
    if not path.is_file():
        raise ValueError(f"{folder} is no behavior: it has no {_INDEX}. Train one with scjax train --config=behavior")
    index = parse_document(path.read_bytes(), _Index, path, _CURE)
    if index.format != BEHAVIOR_FORMAT:
        raise ValueError(f"{path} has format {index.format[:40]!r}, this code reads {BEHAVIOR_FORMAT}: update scjax")
    arrays = read_arrays(folder, index.files)
    try:
        config = BehaviorConfig.from_json(index.config)
        vocabulary = arrays.pop(_VOCABULARY)
        weights = BehaviorWeights(config, named_arrays(arrays)["network"], vocabulary, index.notes)
        weights.check()
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: {error}: {_CURE}") from error
    return weights
