"""Weights of a published encoder, checked against the sizes that its ``config.json`` declares."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import jax.numpy as jnp
import msgspec
import numpy as np
import safetensors.numpy

from scjax.encoders.base import PublishedNetwork, pure_functions
from scjax.nn.functional import Params
from scjax.nn.state_dict import Rules, convert
from scjax.scene.document import parse_document

_CURE = "copy the encoder's folder again"
_LISTED = 5


class _WeightIndex(msgspec.Struct):
    """``model.safetensors.index.json``: key of the state dict -> file."""

    weight_map: dict[str, str]


def read_json_object(path: Path) -> dict[str, Any]:
    """The object in a JSON file; ValueError names the file if that fails."""
    cure = "give the folder of an encoder, or copy it again"
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error}): {cure}") from error
    return parse_document(data, dict, path, cure)


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
    elif not (folder / files[0]).is_file() and (pickles := sorted(path.name for path in folder.glob("*.bin"))):
        raise ValueError(
            f"{folder}: holds {pickles[0]}, a file that may run programs, and no {files[0]}: download the safetensors "
            "file of the release, or convert it"
        )
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


def read_network_state(folder: Path, network: PublishedNetwork) -> dict[str, np.ndarray]:
    """``read_weights``, with the keys that the rules of the network have.

    Raises:
      ValueError: as ``read_weights``, or two arrays of the files have one key.
    """
    state: dict[str, np.ndarray] = {}
    for name, array in read_weights(folder).items():
        key = network.rename(name)
        if key in state:
            raise ValueError(f"the weights hold {key} twice, once as {name}: {_CURE}")
        state[key] = array
    return state


def fit_weights(state: Mapping[str, np.ndarray], network: PublishedNetwork, config: Any) -> Params:
    """The parameters of a network of these sizes.

    Raises:
      ValueError: names the arrays that are missing, unexpected, of another shape or type, or not finite.
    """
    rules = network.weight_rules(config)
    check_weights(state, rules, network.table_shapes(config))
    expected = pure_functions(network, config).shapes()
    unused = [name for name in state if network.is_unused(name)]
    return convert(state, rules, expected, unused, dict(network.aliases))


def weights_digest(state: dict[str, np.ndarray]) -> str:
    """A short hash of 64 values of each array: it differs between encoders, and is fast for billions of weights."""
    digest = hashlib.sha256()
    for name in sorted(state):
        flat = state[name].reshape(-1)
        digest.update(f"{name}{state[name].shape}".encode())
        digest.update(np.ascontiguousarray(flat[:: max(1, flat.size // 64)]).tobytes())
    return digest.hexdigest()[:12]
