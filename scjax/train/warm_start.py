"""Trainings that begin with the parameters of a model: the one that ships, or an unconditional base."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from scjax.generate.model import Model, load_model
from scjax.nn.functional import Params, flatten, unflatten

SHIPPED = "shipped"
"""Value of ``config.init_from`` for the model that ships with the package."""


def load_init_model(init_from: str) -> Model:
    """The model that ``config.init_from`` names: ``SHIPPED``, or a model folder.

    Raises:
      ValueError: as ``load_config_model``.
    """
    return load_model() if init_from == SHIPPED else load_config_model("init_from", init_from)


def load_config_model(field: str, folder: str) -> Model:
    """The model in a folder that a field of the config names.

    Raises:
      ValueError: it is no model folder, or a damaged one; names the field.
    """
    try:
        return load_model(folder)
    except ValueError as error:
        raise ValueError(f"config.{field}: {error}") from error


def warm_start(params: Params, base: Params) -> Params:
    """``params``, replaced by those of ``base`` at every path that it has.

    Raises:
      ValueError: ``base`` has a parameter that ``params`` lacks or holds in another shape.
    """
    leaves = flatten(params)
    for path, value in flatten(base).items():
        if path not in leaves or leaves[path].shape != np.shape(value):
            raise ValueError(
                f"config.init_from: its parameter {'/'.join(map(str, path))} {np.shape(value)} does not fit this "
                "network: choose a base of the same sizes and options, on the same autoencoder"
            )
        leaves[path] = jnp.asarray(value)
    return unflatten(leaves)


def denoiser_base(base: Model, autoencoder: Params, domains: Sequence[str]) -> Params:
    """The parameters of a model's denoiser, adapted to these domains and this autoencoder.

    Domains of the model keep their rows of the label table; other domains start from its null label. The position
    heads are left out if the model has another autoencoder; they are then fitted again.

    Raises:
      ValueError: the model has no denoiser.
    """
    if "denoiser" not in base.components:
        raise ValueError("config.init_from: that model holds no denoiser: give the model folder of that objective")
    config, params = base.denoiser.config, dict(base.denoiser.params)
    names = list(base.domains)
    if names != list(domains):
        rows = [
            config.domains * crop + names.index(domain) if domain in names else config.null_label
            for crop in range(config.crops)
            for domain in domains or ("",)
        ]
        params["labels"] = np.asarray(params["labels"])[[*rows, config.null_label]]
    if "position_heads" in params and not _are_equal(base.autoencoder.params, autoencoder):
        del params["position_heads"]
    return params


def _are_equal(first: Params, second: Params) -> bool:
    leaves, others = flatten(first), flatten(second)
    return leaves.keys() == others.keys() and all(np.array_equal(leaves[path], others[path]) for path in leaves)
