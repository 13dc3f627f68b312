"""Weights of a published text encoder, checked against the sizes that its ``config.json`` declares."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import jax.numpy as jnp
import msgspec
import numpy as np
import safetensors.numpy

from scjax.nn.state_dict import Rules
from scjax.scene.document import parse_document

_CURE = "copy the encoder's folder again"
_LISTED = 5


class _WeightIndex(msgspec.Struct):
    """``model.safetensors.index.json``: key of the state dict -> file."""

    weight_map: dict[str, str]


def read_weights(folder: Path) -> dict[str, np.ndarray]:
    """Name -> array of model.safetensors, or of all files that model.safetensors.index.json names.

    Raises:
      ValueError: names the file that cannot be read, or that lies outside of the folder.
    """
    files = ["model.safetensors"]
    if (path := folder / "model.safetensors.index.json").is_file():
        index: Any = parse_document(path.read_bytes(), _WeightIndex, path, _CURE)
        files = sorted(set(index.weight_map.values()))
        for file in files:
            if PurePosixPath(file).name != file or "\\" in file or "\0" in file:
                raise ValueError(f"{path}: weight_map names {file!r}, which is no file of that folder: {_CURE}")
        if not files:
            raise ValueError(f"{path}: weight_map is empty: {_CURE}")
    state: dict[str, np.ndarray] = {}
    for file in files:
        try:
            state |= safetensors.numpy.load_file(folder / file)
        except Exception as error:  # besides SafetensorError, unknown types of numbers raise several kinds
            raise ValueError(f"{folder / file}: cannot be read ({error}): {_CURE}") from error
    return state


def check_weights(state: Mapping[str, np.ndarray], rules: Rules, table_shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Compares weights with declared sizes, and their values with what float32 holds; allocates nothing of these sizes.

    Args:
      rules: of all arrays that the network needs.
      table_shapes: key and shape of the arrays that decide all sizes.

    Raises:
      ValueError: names the arrays that are missing, of another shape or type, or not finite.
    """
    missing = sorted(rules.keys() - state.keys())
    if missing:
        more = f" and {len(missing) - _LISTED} more" if len(missing) > _LISTED else ""
        raise ValueError(f"the weights do not fit config.json: missing: {', '.join(missing[:_LISTED])}{more}: {_CURE}")
    for key, shape in table_shapes.items():
        if state[key].shape != shape:
            raise ValueError(
                f"the weights do not fit config.json: {key} is {state[key].shape}, its sizes need {shape}: {_CURE}"
            )
    for key in rules:
        array = state[key]
        if not jnp.issubdtype(array.dtype, jnp.floating):
            raise ValueError(f"the weights {key} are {array.dtype}, not floating-point numbers: {_CURE}")
        if not np.isfinite(array).all() or (array.dtype == np.float64 and np.abs(array).max() > np.finfo("f4").max):
            raise ValueError(f"the weights {key} are not finite: {_CURE}")
