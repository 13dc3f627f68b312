"""Muon for kernels of linear layers, AdamW for all else (Jordan et al. 2024, scaled as in arXiv:2502.16982 §2.2)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float
from optax.contrib import MuonDimensionNumbers
from optax.contrib import muon as optax_muon

from scjax.train.flat_params import KEPT, FlatParams, Vectors
from scjax.train.optimizer import KERNEL, clip_by_global_norm, learning_rates

_RMS = 0.2
"""Root mean square of an update at rate 1, about that of AdamW's, whose rates and decay therefore fit."""


def muon(
    packing: FlatParams,
    *,
    learning_rate: float,
    steps: int,
    warmup: int = 500,
    schedule: Literal["linear", "constant"] = "constant",
    weight_decay: float = 1e-5,
    clip: float | None = 10.0,
) -> optax.GradientTransformation:
    """Clipping by global norm, then kernels move by their momentum with all its singular values made about equal.

    Costs some 30 n^3 operations a step for each n x n kernel, whatever the batch: the
    smaller the batch, the more they weigh.

    Args:
      packing: how parameters lie in the vectors that this is a transformation of.
      learning_rate: the rate after warm-up; see ``learning_rates`` for ``steps``, ``warmup`` and ``schedule``.
      clip: largest global norm of the gradient; None to leave it.
    """
    rates = learning_rates(learning_rate, steps=steps, warmup=warmup, schedule=schedule)
    shapes = [shape for _, shape in packing.groups.get(KERNEL, ())]
    matrices = [MuonDimensionNumbers(1, 2)] * len(set(shapes))
    moved: Any = {name: matrices if name == KERNEL else None for name in packing.groups if name != KEPT}
    inner = optax_muon(rates, weight_decay=weight_decay, consistent_rms=_RMS, muon_weight_dimension_numbers=moved)

    def init(params: Any) -> Any:
        return inner.init(_with_kernels(params, stacked, shapes))

    def update(updates: Any, state: Any, params: Any = None) -> tuple[Any, Any]:
        given = None if params is None else _with_kernels(params, stacked, shapes)
        updates, state = inner.update(_with_kernels(updates, stacked, shapes), state, given)
        return _with_kernels(updates, unstacked, shapes), state

    transformation = optax.GradientTransformation(init, update)
    return transformation if clip is None else optax.chain(clip_by_global_norm(clip), transformation)


def stacked(vector: Float[Array, " numbers"], shapes: list[tuple[int, ...]]) -> list[Float[Array, "_ _ _"]]:
    """Kernels of these shapes, one after another in a vector, as one stack for each shape: few, large products."""
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    parts: dict[tuple[int, ...], list] = {}
    for shape, part in zip(shapes, jnp.split(vector, ends[:-1]), strict=True):
        parts.setdefault(shape, []).append(part.reshape(shape))
    return [jnp.stack(part) for part in parts.values()]


def unstacked(stacks: list[Float[Array, "_ _ _"]], shapes: list[tuple[int, ...]]) -> Float[Array, " numbers"]:
    """Inverse of ``stacked``."""
    kinds = {shape: iter(stack) for shape, stack in zip(dict.fromkeys(shapes), stacks, strict=True)}
    return jnp.concatenate([next(kinds[shape]).reshape(-1) for shape in shapes])


def _with_kernels(groups: Any, change: Callable, shapes: list[tuple[int, ...]]) -> Vectors:
    return {name: change(group, shapes) if name == KERNEL else group for name, group in groups.items()}
