"""Trainings that begin with the parameters of a model: of the one that ships, say, or of an unconditional base."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from scjax.generate.model import Model, load_model
from scjax.nn.functional import Params, flatten, unflatten

SHIPPED = "shipped"
"""``config.start`` for the model that ships with the package."""


def model_at(start: str) -> Model:
    """The model that ``config.start`` names."""
    return load_model() if start == SHIPPED else load_model(start)


def started(params: Params, base: Params) -> Params:
    """Fresh parameters, with those of a base wherever it has any.

    Raises:
      ValueError: a parameter of the base that this network lacks, or one of another shape.
    """
    leaves = flatten(params)
    for path, value in flatten(base).items():
        if path not in leaves or leaves[path].shape != np.shape(value):
            raise ValueError(
                f"config.start: its parameter {'/'.join(map(str, path))} {np.shape(value)} does not fit this network: "
                "choose a base of the same sizes and options, on the same autoencoder"
            )
        leaves[path] = jnp.asarray(value)
    return unflatten(leaves)


def denoiser_base(base: Model, autoencoder: Params, domains: Sequence[str]) -> Params:
    """The denoiser of a model as the start of one on these domains and this autoencoder.

    Domains that it knows keep their rows of the label table, others begin as its "not told". What it reads off latents
    is left out, to be fitted anew, where its autoencoder was another one.

    Raises:
      ValueError: it has no denoiser.
    """
    if "denoiser" not in base.components:
        raise ValueError("config.start: that model holds no denoiser: give the model folder of that stage")
    config, params = base.denoiser.config, dict(base.denoiser.params)
    known = config.domains
    names = list(base.domains)
    if names != list(domains):
        rows = [
            known * crop + names.index(domain) if domain in names else config.null_label
            for crop in range(config.crops)
            for domain in domains or ("",)
        ]
        params["labels"] = np.asarray(params["labels"])[[*rows, config.null_label]]
    if "position_heads" in params and not _same(base.autoencoder.params, autoencoder):
        del params["position_heads"]
    return params


def _same(a: Params, b: Params) -> bool:
    one, other = flatten(a), flatten(b)
    return one.keys() == other.keys() and all(np.array_equal(one[path], other[path]) for path in one)
