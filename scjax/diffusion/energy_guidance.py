"""Energy guidance: gradient steps on the x0 estimate reduce an energy of the decoded scene.

A network trained on few scenes leaves lane connections open and boxes overlapping: an error of 0.01 in a latent moves a
lane by decimeters. At the least noisy steps the x0 estimate is decoded and moved down the gradient of the energy [m^2]
through the decoder. The sampler continues from the corrected estimate.

Other names: loss guidance, "backward universal guidance" (Bansal et al. 2023). It needs no gradient of the denoiser,
unlike classifier guidance. Not in the paper. It wraps ``denoise``, so it works with every sampler.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from scjax.diffusion.defaults import DEFAULT_ENERGIES
from scjax.diffusion.energies import ENERGIES
from scjax.diffusion.guidance import Denoise
from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.process import estimate_x0, output_from_x0
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType

Energy = Callable[[PerType], Float[Array, ""]]
"""Normalized latents [B, tokens, latent] per type -> energy of the decoded scenes [m^2], summed over the batch."""

EnergyAround = Callable[[PerType], Energy]
"""Latents -> energy of latents near them. What has no gradient, such as lane links, can be decoded once here."""

_MIN_GRADIENT_STEPS = 4
"""Gradient steps per guided sampler step. Momentum has no effect over one or two."""


@dataclasses.dataclass(frozen=True)
class EnergyGuidance:
    """Options of energy guidance.

    Attributes:
      gradient_steps: total number of gradient steps, spread evenly over the guided sampler steps, at least 4 in each.
      max_sigma: largest noise level with guidance; the last sampler step always counts. Guidance at noisier steps does
        not improve scenes.
      momentum: Nesterov momentum (Nesterov 1983); 0 is plain gradient descent.
      agent_step_size, lane_step_size: step sizes [1 / m^2]. A latent change of 1 moves an agent's center by about 14 m
        and a lane's start by 10 m; a lane has several connections.
      energies: (name, weight) pairs; names as in ``scjax.diffusion.energies.ENERGIES``.
    """

    gradient_steps: int = 8
    max_sigma: float = 0.2
    momentum: float = 0.75
    agent_step_size: float = 1 / 216
    lane_step_size: float = 1 / 540
    energies: tuple[tuple[str, float], ...] = DEFAULT_ENERGIES

    def __post_init__(self):
        if self.gradient_steps < 1:
            raise ValueError(
                f"EnergyGuidance.gradient_steps must be at least 1, not {self.gradient_steps}: "
                "energy_guidance=False turns it off"
            )
        if not 0 <= self.max_sigma <= 1:
            raise ValueError(f"EnergyGuidance.max_sigma must lie in 0..1, not {self.max_sigma}: it is a noise level")
        if not 0 <= self.momentum < 1:
            raise ValueError(
                f"EnergyGuidance.momentum must lie in 0..1, 1 excluded, not {self.momentum}: it would not converge"
            )
        if not (self.agent_step_size >= 0 and self.lane_step_size >= 0):
            raise ValueError(
                "EnergyGuidance.agent_step_size and .lane_step_size must not be negative, not "
                f"{self.agent_step_size}, {self.lane_step_size}"
            )
        if not self.energies:
            raise ValueError("EnergyGuidance.energies is empty: energy_guidance=False turns it off")
        for name, weight in self.energies:
            if name not in ENERGIES:
                raise ValueError(f"EnergyGuidance.energies names {name!r}: choose from {', '.join(ENERGIES)}")
            if not 0 <= weight < float("inf"):
                raise ValueError(f"EnergyGuidance.energies gives {name!r} the weight {weight}: it must not be negative")

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> EnergyGuidance:
        """Inverse of ``dataclasses.asdict``, also after JSON, which turns tuples into lists."""
        fields = dict(fields)
        if "energies" in fields:
            fields["energies"] = tuple((name, float(weight)) for name, weight in fields["energies"])
        return cls(**fields)


def gradient_steps_per_level(options: EnergyGuidance, levels: NoiseLevel) -> Int[np.ndarray, " s"]:
    """Gradient steps at every level of a sampler's schedule [S], index 0 the least noisy; 0 where there is none."""
    guided_levels = max(int((np.asarray(levels.sigma) <= options.max_sigma).sum()), 1)
    steps = min(guided_levels, -(-options.gradient_steps // _MIN_GRADIENT_STEPS))
    counts = np.zeros(len(levels.sigma), np.int32)
    counts[np.linspace(0, guided_levels - 1, steps).round().astype(int)] = -(-options.gradient_steps // steps)
    return counts


def with_energy_guidance(
    denoise: Denoise,
    levels: NoiseLevel,
    prediction: Prediction,
    energy_around: EnergyAround,
    generated: PerType,
    options: EnergyGuidance,
) -> Denoise:
    """``denoise`` whose x0 estimate has moved down the gradient of an energy.

    Args:
      levels: levels of the sampler's schedule [S]. ``denoise`` is called at these only, all scenes at the same one.
      prediction: what ``denoise`` returns.
      energy_around: called once per guided sampler step, with the x0 estimate.
      generated: True at generated tokens [B, tokens] per type. The others are known, clean in z, and do not move.
      options: number and size of the gradient steps.
    """
    gradient_steps = jnp.asarray(gradient_steps_per_level(options, levels))
    step_size = PerType(agents=options.agent_step_size, lanes=options.lane_step_size)

    def minimize(x0: PerType, step: Int[Array, ""]) -> PerType:
        gradient = jax.grad(energy_around(x0))

        def nesterov(_: Int[Array, ""], carry: tuple[PerType, PerType]) -> tuple[PerType, PerType]:
            x, velocity = carry
            lookahead = jax.tree.map(lambda x, v: x + options.momentum * v, x, velocity)
            velocity = jax.tree.map(
                lambda v, g, mask, size: jnp.where(mask[..., None], options.momentum * v - size * g, 0).astype(v.dtype),
                velocity,
                gradient(lookahead),
                generated,
                step_size,
            )
            return jax.tree.map(jnp.add, x, velocity), velocity

        return jax.lax.fori_loop(0, gradient_steps[step], nesterov, (x0, jax.tree.map(jnp.zeros_like, x0)))[0]

    def denoise_with_energy(z: PerType, t: Real[Array, " b"]) -> PerType:
        output = denoise(z, t)
        step = jnp.searchsorted(jnp.asarray(levels.time), t[0])

        def guided_output() -> PerType:
            level = levels[jnp.broadcast_to(step, t.shape)]
            estimate = estimate_x0(level, z, output, prediction)
            x0 = jax.tree.map(lambda x, clean, mask: jnp.where(mask[..., None], x, clean), estimate, z, generated)
            return output_from_x0(level, z, minimize(x0, step), prediction)

        return jax.lax.cond(gradient_steps[step] > 0, guided_output, lambda: output)

    return denoise_with_energy
