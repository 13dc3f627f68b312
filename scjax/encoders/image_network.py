"""What image encoders and depth networks share: loading a folder, and running pictures in groups."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from scjax.encoders.base import CONFIG_FILE, PublishedNetwork, pure_functions
from scjax.encoders.weights import fit_weights, read_json_object, read_network_state, weights_digest
from scjax.nn.cpu.precision import Compute
from scjax.nn.functional import Params

GROUP = 8
"""Pictures in a call of a network."""

_Item = TypeVar("_Item")


class LoadedNetwork(NamedTuple):
    """A network with its weights; ``name`` changes with them."""

    network: PublishedNetwork
    config: Any
    params: Params
    name: str


def load_network(folder: Path, networks: Mapping[str, PublishedNetwork], compute: Compute) -> LoadedNetwork:
    """The network in a folder with config.json and weights in safetensors files.

    Args:
      networks: ``model_type`` of a ``config.json`` -> the network that reads such folders.
      compute: precision of products with the weights.

    Raises:
      ValueError: names the file, array or field at fault and the cure.
    """
    content = read_json_object(folder / CONFIG_FILE)
    model_type = content.get("model_type")
    if not isinstance(model_type, str) or model_type not in networks:
        raise ValueError(
            f"{folder / CONFIG_FILE}: model type {model_type!r} is not supported here: use {' or '.join(networks)}"
        )
    network = networks[model_type]
    try:
        config = network.read_config(content).with_compute(compute)
        state = read_network_state(folder, network)
        params = fit_weights(state, network, config)
    except ValueError as error:
        raise ValueError(f"{folder}: {error}") from error
    return LoadedNetwork(network, config, params, f"{model_type}-{weights_digest(state)}")


@functools.lru_cache(maxsize=8)
def compiled_network(network: PublishedNetwork, config: Any) -> Callable[..., Array]:
    """(parameters, pixels) -> result, compiled for every size of pictures."""
    return jax.jit(pure_functions(network, config).apply)


def in_groups(items: Sequence[_Item]) -> Iterator[Sequence[_Item]]:
    """Parts of ``GROUP`` items; the last may be shorter."""
    for start in range(0, len(items), GROUP):
        yield items[start : start + GROUP]


def run_padded(
    program: Callable[..., Array], params: Params, pixels: Sequence[Float[np.ndarray, "height width 3"]]
) -> np.ndarray:
    """Results of pictures of one size. One picture runs alone, more in a group of ``GROUP``: two programs in all."""
    rows = 1 if len(pixels) == 1 else GROUP
    batch = np.zeros((rows, *pixels[0].shape), np.float32)
    batch[: len(pixels)] = pixels
    return np.asarray(program(params, jnp.asarray(batch)))[: len(pixels)]
