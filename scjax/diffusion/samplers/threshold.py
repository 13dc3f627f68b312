"""Bounds on the estimate of x_0, static or by a quantile of each scene (Saharia et al. 2022, "dynamic thresholding").

Guidance, and the noise at the most noisy times, throw the estimate out of the data's range.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from scjax.scene.per_type import PerType

BOUND = 5.0  # latents are normalised: five standard deviations, as the release clips its states


@dataclasses.dataclass(frozen=True)
class Threshold:
    """How estimates are bounded.

    Attributes:
      bound: largest absolute value of a normalised latent.
      quantile: None clips to +-bound (static). Otherwise, where this quantile q of a scene's absolute values of a kind
        exceeds the bound, they are clipped to +-q and multiplied by bound / q (dynamic): fewer numbers saturate.
    """

    bound: float = BOUND
    quantile: float | None = None

    def __post_init__(self):
        if not self.bound > 0:
            raise ValueError(f"Threshold.bound must be positive, not {self.bound}")
        if self.quantile is not None and not 0 < self.quantile <= 1:
            raise ValueError(f"Threshold.quantile must lie in (0, 1], not {self.quantile}: 0.995 is usual")


def thresholded(x0: PerType, generated: PerType, threshold: Threshold | None) -> PerType:
    """Bounded estimates; quantiles are of the tokens ``generated`` [B, tokens], so that padding never changes them."""
    if threshold is None:
        return x0

    def bounded(x: Array, mask: Array) -> Array:
        if threshold.quantile is None:
            return jnp.clip(x, -threshold.bound, threshold.bound)
        most = jnp.maximum(_quantile(jnp.abs(x), mask, threshold.quantile), threshold.bound)[:, None, None]
        return jnp.clip(x, -most, most) * (threshold.bound / most)

    return jax.tree.map(bounded, x0, generated)


def _quantile(x: Float[Array, "b n d"], mask: Bool[Array, "b n"], q: float) -> Float[Array, " b"]:
    """The least value of a scene that a share q of its values does not exceed; 0 without any."""
    counted = jnp.where(mask[..., None], x, jnp.inf).reshape(len(x), -1)
    count = mask.sum(-1) * x.shape[-1]
    rank = jnp.maximum(jnp.ceil(q * count).astype(jnp.int32) - 1, 0)
    found = jnp.take_along_axis(jnp.sort(counted, -1), rank[:, None], -1)[:, 0]
    return jnp.where(count > 0, found, 0)
