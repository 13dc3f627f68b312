"""Latents as the denoiser sees them: one scalar mean and standard deviation a kind (official-spec §2.5, §5.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import jax
import numpy as np

from scjax.scene.per_type import Nodes


@dataclasses.dataclass(frozen=True)
class LatentStatistics:
    """Mean and standard deviation of all latent numbers of a kind: Nodes of floats (or their dicts, from JSON)."""

    mean: Nodes | Mapping[str, float]
    std: Nodes | Mapping[str, float]

    def __post_init__(self):
        for name in ("mean", "std"):
            value = getattr(self, name)
            if isinstance(value, Mapping):
                object.__setattr__(self, name, Nodes(**value))
        if min(jax.tree.leaves(self.std)) <= 0:
            raise ValueError(f"standard deviations of latents must be positive, got {self.std}")

    @classmethod
    def identity(cls) -> LatentStatistics:
        """Leaves latents as they are."""
        return cls(mean=Nodes(agents=0.0, lanes=0.0), std=Nodes(agents=1.0, lanes=1.0))

    def normalise(self, latents: Nodes) -> Nodes:
        """(z - mean) / std."""
        return jax.tree.map(lambda z, mean, std: (z - mean) / std, latents, self.mean, self.std)

    def denormalise(self, latents: Nodes) -> Nodes:
        """z std + mean."""
        return jax.tree.map(lambda z, mean, std: z * std + mean, latents, self.mean, self.std)


def statistics(latents: Sequence[Nodes], masks: Sequence[Nodes]) -> LatentStatistics:
    """Over the valid tokens of many batches of sampled latents [B, tokens, latent], masks [B, tokens]; float64.

    Raises:
      ValueError: if there is no valid token of a kind.
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
    return LatentStatistics(mean=Nodes(**mean), std=Nodes(**std))
