"""AdamW as the release uses it, for both networks (official-spec §2.6, §6)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from scjax.nn.functional import Params

KERNEL = "kernel"
"""Name of the parameters that weight decay acts on."""


def adamw(
    *,
    learning_rate: float,
    steps: int,
    warmup: int = 500,
    schedule: Literal["linear", "constant"] = "constant",
    weight_decay: float = 1e-5,
    clip: float | None = 10.0,
    b1: float = 0.9,
    b2: float = 0.999,
    eps: float = 1e-7,
) -> optax.GradientTransformation:
    """Clips by the global norm, then AdamW with decoupled weight decay on the kernels of linear layers only.

    Args:
      learning_rate: the rate after warm-up; see ``learning_rates`` for ``steps``, ``warmup`` and ``schedule``.
      clip: largest global norm of the gradient; None: no clipping.
    """
    rates = learning_rates(learning_rate, steps=steps, warmup=warmup, schedule=schedule)
    adam = optax.adamw(rates, b1=b1, b2=b2, eps=eps, weight_decay=weight_decay, mask=is_decayed)
    return adam if clip is None else optax.chain(clip_by_global_norm(clip), adam)


def learning_rates(
    peak: float, *, steps: int, warmup: int, schedule: Literal["linear", "constant"]
) -> Callable[[Any], Float[Array, ""]]:
    """An optax schedule, number of updates -> learning rate.

    Linear from 0 to ``peak`` at ``warmup``, then constant, or linear to 0 at ``steps``. The first update has rate 0.

    Raises:
      ValueError: unknown ``schedule``, or a linear one that ends before the warm-up does.
    """
    if schedule not in ("linear", "constant"):
        raise ValueError(f'schedule must be "linear" or "constant", got {schedule!r}')
    if schedule == "linear" and steps <= warmup:
        raise ValueError(f"a linear schedule of {steps} steps ends before its warm-up of {warmup}: shorten the warm-up")

    def rate(count: Any) -> Float[Array, ""]:
        count = jnp.asarray(count, jnp.float32)
        rising = count / max(warmup, 1)
        falling = jnp.float32(1) if schedule == "constant" else jnp.maximum((steps - count) / (steps - warmup), 0)
        return peak * jnp.where(count < warmup, rising, falling)

    return rate


def is_decayed(params: Params) -> Params:
    """True at the leaves that weight decay acts on: those named ``KERNEL``, in a layer or in the groups of a state."""
    return jax.tree_util.tree_map_with_path(
        lambda path, _: jax.tree_util.keystr(path, simple=True, separator=".").rsplit(".")[-1] == KERNEL, params
    )


def clip_by_global_norm(largest: float) -> optax.GradientTransformation:
    """Scales by min(1, largest / (norm + 1e-6)): PyTorch's rule, where optax's has no offset."""

    def update(gradients, _params):
        scale = jnp.minimum(1.0, largest / (optax.tree.norm(gradients) + 1e-6))
        return jax.tree.map(lambda g: g * scale.astype(g.dtype), gradients)

    return optax.stateless(update)
