"""Muon for kernels of linear layers, AdamW for all else (Jordan et al. 2024, scaled as in arXiv:2502.16982 §2.2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, cast

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float
from optax.contrib import MuonDimensionNumbers
from optax.contrib import muon as optax_muon

from scjax.train.optimizer import KERNEL, clip_by_global_norm, learning_rates
from scjax.train.param_groups import Groups, ParamGroups

_RMS = 0.2
"""Root mean square of an update at rate 1: about that of AdamW, so that its rates and weight decay fit."""


def muon(
    param_groups: ParamGroups,
    *,
    learning_rate: float,
    steps: int,
    warmup: int = 500,
    schedule: Literal["linear", "constant"] = "constant",
    weight_decay: float = 1e-5,
    clip: float | None = 10.0,
) -> optax.GradientTransformation:
    """Clips by the global norm, then moves kernels by their momentum with about equal singular values.

    A step takes some 30 n^3 operations per n x n kernel, for any batch size.

    Args:
      param_groups: how the groups that this transforms hold the parameters.
      learning_rate: the rate after warm-up; see ``learning_rates`` for ``steps``, ``warmup`` and ``schedule``.
      clip: largest global norm of the gradient; None: no clipping.
    """
    rates = learning_rates(learning_rate, steps=steps, warmup=warmup, schedule=schedule)
    shapes = param_groups.kernel_shapes
    inner = optax_muon(
        rates,
        weight_decay=weight_decay,
        consistent_rms=_RMS,
        muon_weight_dimension_numbers=cast(Any, _matrix_dimensions),
    )

    def stack_kernels(groups: Groups) -> Groups:
        return _with_kernels(groups, lambda group: stacked(param_groups.split_kernels(group)))

    def init(params: Any) -> Any:
        return inner.init(stack_kernels(params))

    def update(updates: Any, state: Any, params: Any = None) -> tuple[Any, Any]:
        stacks = None if params is None else stack_kernels(params)
        updates, state = inner.update(stack_kernels(updates), state, stacks)
        return _with_kernels(updates, lambda stacks: param_groups.join_kernels(unstacked(stacks, shapes))), state

    transformation = optax.GradientTransformation(init, update)
    return transformation if clip is None else optax.chain(clip_by_global_norm(clip), transformation)


def stacked(kernels: list[Float[Array, "_ _"]]) -> list[Float[Array, "_ _ _"]]:
    """One stack per shape of the kernels: a few large products instead of many small ones."""
    parts: dict[tuple[int, ...], list] = {}
    for kernel in kernels:
        parts.setdefault(kernel.shape, []).append(kernel)
    return [jnp.stack(part) for part in parts.values()]


def unstacked(stacks: list[Float[Array, "_ _ _"]], shapes: list[tuple[int, ...]]) -> list[Float[Array, "_ _"]]:
    """Inverse of ``stacked`` for kernels of these shapes."""
    rows = {shape: iter(stack) for shape, stack in zip(dict.fromkeys(shapes), stacks, strict=True)}
    return [next(rows[shape]) for shape in shapes]


def _matrix_dimensions(groups: Groups) -> Any:
    """Muon for the stacks of kernels, whose matrices are axes 1 and 2; None (AdamW) for all other arrays."""
    return {
        name: [MuonDimensionNumbers(1, 2)] * len(group) if name == KERNEL else jax.tree.map(lambda _: None, group)
        for name, group in groups.items()
    }


def _with_kernels(groups: Groups, change: Callable[[Any], Any]) -> Groups:
    return {name: change(group) if name == KERNEL else group for name, group in groups.items()}
