"""Classifier-free guidance as a wrapper around one ``denoise(z, t)``: both branches in one batch (spec §5.3).

In an interval of times (Kynkäänniemi et al. 2024): at the noisiest it narrows what is drawn, at the last it does
nothing good. Rescaled (Lin et al. 2023): a large weight inflates the estimate, whose deviation is led back.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from scjax.scene.per_type import PerType

Denoise = Callable[[PerType, Real[Array, " b"]], PerType]
T = TypeVar("T")
Interval = tuple[float | int, float | int]

DEFAULT_GUIDANCE_SCALE = 2.0
"""Of conditional models, where nothing is said."""


@dataclasses.dataclass(frozen=True)
class Guidance:
    """How an estimate is led towards its condition.

    Attributes:
      weight: w in u + w (c - u), of the conditional estimate c and the unconditional u; 1 is c itself.
      interval: the times, lowest and highest (0..99, 99 the noisiest), outside of which w is 1; None: all times.
      rescale: phi, the share of the result that is scaled to the deviation that c has in each scene and kind.
    """

    weight: float = DEFAULT_GUIDANCE_SCALE
    interval: Interval | None = None
    rescale: float = 0.0

    def __post_init__(self):
        if not math.isfinite(self.weight):
            raise ValueError(f"Guidance.weight must be a finite number, not {self.weight}: 1 is no guidance")
        if self.interval is not None and not (len(self.interval) == 2 and self.interval[0] <= self.interval[1]):
            raise ValueError(f"Guidance.interval must be (lowest time, highest time), not {self.interval}")
        if not 0 <= self.rescale <= 1:
            raise ValueError(f"Guidance.rescale must lie in 0 (none)..1 (all of the deviation), not {self.rescale}")


def join(conditional: T, unconditional: T) -> T:
    """Two PyTrees of batches -> one of twice the batch, the conditional half first."""
    return jax.tree.map(lambda c, u: jnp.concatenate([c, u]), conditional, unconditional)


def guided(
    denoise_both: Denoise,
    weight: float | Float[Array, "*b"],
    *,
    interval: Interval | None = None,
    rescale: float = 0.0,
    generated: PerType | None = None,
    denoise_one: Denoise | None = None,
) -> Denoise:
    """eps_u + w (eps_c - eps_u); w = 1 is the conditional estimate, 4 the official choice.

    Args:
      denoise_both: estimate of a batch of 2 B whose first half is conditional (see ``join``).
      weight: w, or one a scene [B].
      interval, rescale: as in ``Guidance``.
      generated: True at the tokens that are generated [B, tokens] a kind, of which deviations are taken; None: all.
      denoise_one: the conditional estimate alone, run where no scene's time lies in the interval.
    """

    def inside(t: Real[Array, " b"]) -> Bool[Array, " b"]:
        return jnp.ones(t.shape, bool) if interval is None else (interval[0] <= t) & (t <= interval[1])

    def denoise(z: PerType, t: Real[Array, " b"]) -> PerType:
        both = denoise_both(join(z, z), jnp.concatenate([t, t]))
        w = jnp.where(inside(t), weight, 1)[:, None, None]
        conditional, unconditional = (jax.tree.map(lambda x, i=i: jnp.split(x, 2)[i], both) for i in (0, 1))
        led = jax.tree.map(lambda c, u: u + w.astype(c.dtype) * (c - u), conditional, unconditional)
        return rescaled(led, conditional, rescale, generated) if rescale else led

    if interval is None or denoise_one is None:
        return denoise
    return lambda z, t: jax.lax.cond(inside(t).any(), denoise, denoise_one, z, t)


def rescaled(led: PerType, conditional: PerType, share: float, generated: PerType | None = None) -> PerType:
    """share * led * std(conditional) / std(led) + (1 - share) * led, deviations a scene and kind."""
    generated = jax.tree.map(lambda x: jnp.ones(x.shape[:2], bool), led) if generated is None else generated

    def scaled(led: Array, conditional: Array, mask: Array) -> Array:
        wanted, found = (_deviation(x, mask) for x in (conditional, led))
        factor = jnp.where(found > 0, wanted / jnp.where(found > 0, found, 1), 1)[:, None, None]
        return (share * factor + (1 - share)) * led

    return jax.tree.map(scaled, led, conditional, generated)


def _deviation(x: Float[Array, "b n d"], mask: Bool[Array, "b n"]) -> Float[Array, " b"]:
    count = jnp.maximum(mask.sum(-1) * x.shape[-1], 1).astype(x.dtype)
    x = jnp.where(mask[..., None], x, 0)
    mean = x.sum((1, 2)) / count
    return jnp.sqrt(jnp.where(mask[..., None], jnp.square(x - mean[:, None, None]), 0).sum((1, 2)) / count)
