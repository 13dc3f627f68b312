"""Classifier-free guidance (Ho & Salimans 2022) as a wrapper around ``denoise(z, t)``; spec §5.3.

One batch holds both branches. Guidance can be limited to an interval of times (Kynkäänniemi et al. 2024): at the
noisiest times it reduces diversity, at the last ones it has no effect. A large scale inflates the standard deviation of
the estimate; rescaling (Lin et al. 2023) restores it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Real

from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE
from scjax.scene.arguments import finite_number
from scjax.scene.per_type import PerType

Denoise = Callable[[PerType, Real[Array, " b"]], PerType]
"""(noisy latents [B, tokens, latent] per type, times [B]) -> network output of the same shapes."""

T = TypeVar("T")
MAX_SCALE = 1000.0
"""Larger scales of guidance leave nothing of a scene."""

Interval = tuple[float | int, float | int]


@dataclasses.dataclass(frozen=True)
class Guidance:
    """Options of classifier-free guidance.

    Attributes:
      scale: w in u + w (c - u), where c is the conditional and u the unconditional estimate; 1 is no guidance.
      interval: lowest and highest time (0..99, 99 the noisiest) with guidance; outside w is 1. None: all times.
      rescale: phi in 0..1, share of the result that is scaled to the standard deviation of c per scene and type.
      image_scale: v in u + w (r - u) + v (c - r), where r is the estimate with the request and without the picture
        (Brooks et al. 2023); w is then the scale of the request alone. It takes half as long again. None: w is the
        scale of both.
    """

    scale: float = DEFAULT_GUIDANCE_SCALE
    interval: Interval | None = None
    rescale: float = 0.0
    image_scale: float | None = None

    def __post_init__(self):
        finite_number(self.scale, "Guidance.scale (1 is no guidance)", -MAX_SCALE, MAX_SCALE)
        if self.image_scale is not None:
            finite_number(self.image_scale, "Guidance.image_scale (1 is no guidance)", -MAX_SCALE, MAX_SCALE)
        finite_number(self.rescale, "Guidance.rescale, from none to all of the deviation,", 0.0, 1.0)
        if self.interval is None:
            return
        if not isinstance(self.interval, tuple | list) or len(self.interval) != 2:
            raise ValueError(f"Guidance.interval must be (lowest time, highest time), not {self.interval!r}")
        low, high = (finite_number(time, "a time of Guidance.interval") for time in self.interval)
        if low > high:
            raise ValueError(f"Guidance.interval must be (lowest time, highest time), not {self.interval}")


def concat_branches(conditional: T, unconditional: T) -> T:
    """Concatenates two PyTrees of batches [B, ...] to [2 B, ...]; the conditional half comes first."""
    return jax.tree.map(lambda c, u: jnp.concatenate([c, u]), conditional, unconditional)


def with_guidance(
    denoise_both: Denoise,
    scale: float | Float[Array, "*b"],
    *,
    image_scale: float | Float[Array, "*b"] | None = None,
    interval: Interval | None = None,
    rescale: float = 0.0,
    generated: PerType | None = None,
    denoise_conditional: Denoise | None = None,
) -> Denoise:
    """Guided estimate u + w (c - u). The official release uses w = 4.

    Args:
      denoise_both: estimate of a batch of 2 B whose first half is conditional (see ``concat_branches``); with
        ``image_scale`` of 3 B, whose last part is conditional but for the picture.
      scale: w, one for all scenes or one per scene [B].
      image_scale: v, as in ``Guidance``.
      interval, rescale: as in ``Guidance``.
      generated: True at generated tokens [B, tokens] per type, which rescaling measures; None: all tokens.
      denoise_conditional: the conditional branch alone, used when no scene's time lies in the interval.
    """

    def in_interval(t: Real[Array, " b"]) -> Bool[Array, " b"]:
        return jnp.ones(t.shape, bool) if interval is None else (interval[0] <= t) & (t <= interval[1])

    def denoise(z: PerType, t: Real[Array, " b"]) -> PerType:
        branches, times = concat_branches(z, z), [t, t]
        if image_scale is not None:
            branches, times = concat_branches(branches, z), [t, t, t]
        estimates = denoise_both(branches, jnp.concatenate(times))
        parts = [jax.tree.map(lambda x, i=i: jnp.split(x, len(times))[i], estimates) for i in range(len(times))]
        conditional, unconditional, request = parts[0], parts[1], parts[-1 if image_scale is not None else 0]
        w = jnp.where(in_interval(t), scale, 1)[:, None, None]
        guided = jax.tree.map(lambda c, u: u + w.astype(c.dtype) * (c - u), request, unconditional)
        if image_scale is not None:
            v = jnp.where(in_interval(t), image_scale, 1)[:, None, None]
            guided = jax.tree.map(lambda g, c, r: g + v.astype(c.dtype) * (c - r), guided, conditional, request)
        return rescale_guidance(guided, conditional, rescale, generated) if rescale else guided

    if interval is None or denoise_conditional is None:
        return denoise
    return lambda z, t: jax.lax.cond(in_interval(t).any(), denoise, denoise_conditional, z, t)


def rescale_guidance(guided: PerType, conditional: PerType, phi: float, generated: PerType | None = None) -> PerType:
    """phi * guided * std(conditional) / std(guided) + (1 - phi) * guided, with one std per scene and type.

    Args:
      guided, conditional: estimates [B, tokens, latent] per type.
      phi: share of the rescaled estimate, 0..1.
      generated: True at the tokens that count [B, tokens] per type; None: all tokens.
    """
    generated = jax.tree.map(lambda x: jnp.ones(x.shape[:2], bool), guided) if generated is None else generated

    def rescale(guided: Array, conditional: Array, mask: Array) -> Array:
        target_std, std = (_masked_std(x, mask) for x in (conditional, guided))
        factor = jnp.where(std > 0, target_std / jnp.where(std > 0, std, 1), 1)[:, None, None]
        return (phi * factor + (1 - phi)) * guided

    return jax.tree.map(rescale, guided, conditional, generated)


def _masked_std(x: Float[Array, "b n d"], mask: Bool[Array, "b n"]) -> Float[Array, " b"]:
    count = jnp.maximum(mask.sum(-1) * x.shape[-1], 1).astype(x.dtype)
    x = jnp.where(mask[..., None], x, 0)
    mean = x.sum((1, 2)) / count
    return jnp.sqrt(jnp.where(mask[..., None], jnp.square(x - mean[:, None, None]), 0).sum((1, 2)) / count)
