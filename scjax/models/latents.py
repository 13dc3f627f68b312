"""Standardized latents, the denoiser's data: one scalar mean and deviation per type (official-spec §2.5, §5.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np

from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class LatentStatistics:
    """Mean and standard deviation of all latent numbers per type: ``PerType`` of floats (or dicts, from JSON)."""

    mean: PerType | Mapping[str, float]
    std: PerType | Mapping[str, float]

    def __post_init__(self):
        for name in ("mean", "std"):
            value = getattr(self, name)
            if isinstance(value, Mapping):
                object.__setattr__(self, name, PerType(**value))
        if min(jax.tree.leaves(self.std)) <= 0:
            raise ValueError(f"standard deviations of latents must be positive, got {self.std}")

    @classmethod
    def identity(cls) -> LatentStatistics:
        """Mean 0 and deviation 1."""
        return cls(mean=PerType(agents=0.0, lanes=0.0), std=PerType(agents=1.0, lanes=1.0))

    def normalize(self, latents: PerType) -> PerType:
        """(z - mean) / std."""
        return jax.tree.map(lambda z, mean, std: (z - mean) / std, latents, self.mean, self.std)

    def denormalize(self, latents: PerType) -> PerType:
        """z std + mean."""
        return jax.tree.map(lambda z, mean, std: z * std + mean, latents, self.mean, self.std)


def statistics(latents: Sequence[PerType], masks: Sequence[PerType]) -> LatentStatistics:
    """Statistics over the valid tokens of many batches of latents [B, tokens, latent], masks [B, tokens]; float64.

    Raises:
      ValueError: there is no valid token of a type.
    """
    mean, std = {}, {}
    for kind in ("agents", "lanes"):
        count, total, squares = 0, 0.0, 0.0
        for batch, mask in zip(latents, masks, strict=True):
            values = np.asarray(getattr(batch, kind), np.float64)[np.asarray(getattr(mask, kind))]
            count, total, squares = count + values.size, total + values.sum(), squares + np.square(values).sum()
        if count == 0:
            raise ValueError(f"no valid {kind} in {len(latents)} batches of latents: their statistics are undefined")
        mean[kind] = float(total / count)
        std[kind] = float(np.sqrt(max(squares / count - mean[kind] ** 2, 1e-12)))
    return LatentStatistics(mean=PerType(**mean), std=PerType(**std))
