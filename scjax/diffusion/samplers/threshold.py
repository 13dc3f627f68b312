"""Thresholding: static or dynamic bounds on the x0 estimate (Saharia et al. 2022).

Guidance and the noisiest times push the x0 estimate out of the range of the data.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from scjax.diffusion.defaults import DEFAULT_LATENT_BOUND
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class Threshold:
    """Bound on x0 estimates.

    Attributes:
      bound: largest absolute value of a normalized latent [standard deviations].
      quantile: None clips to +-bound (static thresholding). Otherwise (dynamic thresholding), let q be this quantile of
        the absolute values of a scene and type. If q exceeds the bound, values are clipped to +-q and scaled by
        bound / q, so that fewer values saturate.
    """

    bound: float = DEFAULT_LATENT_BOUND
    quantile: float | None = None

    def __post_init__(self):
        if not self.bound > 0:
            raise ValueError(f"Threshold.bound must be positive, not {self.bound}")
        if self.quantile is not None and not 0 < self.quantile <= 1:
            raise ValueError(f"Threshold.quantile must lie in (0, 1], not {self.quantile}: 0.995 is usual")


def threshold_x0(x0: PerType, generated: PerType, threshold: Threshold | None) -> PerType:
    """Bounded x0 estimates [B, tokens, latent] per type.

    Args:
      generated: True at generated tokens [B, tokens] per type. Quantiles use these only, so padding has no effect.
      threshold: None returns ``x0`` unchanged.
    """
    if threshold is None:
        return x0

    def bound(x: Array, mask: Array) -> Array:
        if threshold.quantile is None:
            return jnp.clip(x, -threshold.bound, threshold.bound)
        limit = jnp.maximum(_masked_quantile(jnp.abs(x), mask, threshold.quantile), threshold.bound)[:, None, None]
        return jnp.clip(x, -limit, limit) * (threshold.bound / limit)

    return jax.tree.map(bound, x0, generated)


def _masked_quantile(x: Float[Array, "b n d"], mask: Bool[Array, "b n"], q: float) -> Float[Array, " b"]:
    """Smallest value of a scene that at least a share q of its values does not exceed; 0 for a scene without values."""
    values = jnp.where(mask[..., None], x, jnp.inf).reshape(len(x), -1)
    count = mask.sum(-1) * x.shape[-1]
    rank = jnp.maximum(jnp.ceil(q * count).astype(jnp.int32) - 1, 0)
    quantile = jnp.take_along_axis(jnp.sort(values, -1), rank[:, None], -1)[:, 0]
    return jnp.where(count > 0, quantile, 0)
