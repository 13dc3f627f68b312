"""Steering: where there is little noise left, the estimate of x_0 is led down an energy of the decoded scene.

A network that has seen few scenes leaves joints open and boxes in each other: a latent number off by a hundredth moves
a lane by decimetres. What is wrong is seen in metres, so the estimate is decoded, and descends the gradient of
``soundness`` through the decoder; from there the sampler goes on, so that the network answers to what was moved.
(Descent of the estimate itself, without a gradient of the network: the "backward guidance" of Bansal et al. 2023; not
in the paper.) A wrapper around ``denoise``, as guidance is, and so for every sampler.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from scjax.diffusion.guidance import Denoise
from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.process import estimate_x0, output_for
from scjax.models.denoiser.config import Prediction
from scjax.scene.per_type import PerType

Energy = Callable[[PerType], Float[Array, ""]]
"""Normalised latents [B, tokens, latent] -> energy of the decoded scenes [m^2], summed over them."""

EnergyAround = Callable[[PerType], Energy]
"""The energy of latents near the given ones: what has no gradient, which lanes are linked, may be taken from those."""

_TOGETHER = 4  # gradient steps that gather momentum; one or two a step of a sampler do not


@dataclasses.dataclass(frozen=True)
class EnergyGuidance:
    """How estimates are steered.

    Attributes:
      rounds: gradient steps in all, spread evenly over steps of the sampler, four or more a step.
      below: noise up to which steps are chosen for it, the last one always. Earlier ones gain nothing
        (experiments/results/shipped).
      momentum: share of a gradient step's way that the next one goes on (Nesterov 1983); 0 is plain descent.
      agents, lanes: length of a gradient step [1 / m^2]. An agent's centre moves by some 14 m, a lane's start by 10 m,
        as its latents move by 1, and a lane has joints with several.
    """

    rounds: int = 8
    below: float = 0.2
    momentum: float = 0.75
    agents: float = 1 / 216
    lanes: float = 1 / 540

    def __post_init__(self):
        if self.rounds < 1:
            raise ValueError(
                f"EnergyGuidance.rounds must be at least 1, not {self.rounds}: energy_guidance=False is none"
            )
        if not 0 <= self.below <= 1:
            raise ValueError(f"EnergyGuidance.below must lie in 0..1, not {self.below}: it is a level of noise")
        if not 0 <= self.momentum < 1:
            raise ValueError(
                f"EnergyGuidance.momentum must lie in 0..1, 1 excluded, not {self.momentum}: it would not settle"
            )
        if not (self.agents >= 0 and self.lanes >= 0):
            raise ValueError(f"EnergyGuidance.agents and .lanes must not be negative, not {self.agents}, {self.lanes}")


def rounds_of(number: int, below: float, levels: NoiseLevel) -> Int[np.ndarray, " s"]:
    """Gradient steps at every level of a sampler's schedule, index 0 the least noisy; as in ``EnergyGuidance``."""
    quiet = max(int((np.asarray(levels.noise) <= below).sum()), 1)
    steps = min(quiet, -(-number // _TOGETHER))
    rounds = np.zeros(len(levels.noise), np.int32)
    rounds[np.linspace(0, quiet - 1, steps).round().astype(int)] = -(-number // steps)
    return rounds


def with_energy_guidance(
    denoise: Denoise,
    levels: NoiseLevel,
    prediction: Prediction,
    energy: EnergyAround,
    generated: PerType,
    energy_guidance: EnergyGuidance,
) -> Denoise:
    """``denoise`` whose estimate of x_0 has descended ``energy``.

    Args:
      levels: of the sampler's schedule, the only ones at which it will be asked; all scenes at the same.
      energy: the one around an estimate is taken once, for all rounds of a step.
      generated: True at the tokens that are generated [B, tokens] a kind; the others, clean in z, are not moved.
    """
    rounds = jnp.asarray(rounds_of(energy_guidance.rounds, energy_guidance.below, levels))
    length = PerType(agents=energy_guidance.agents, lanes=energy_guidance.lanes)

    def descended(start: PerType, step: Int[Array, ""]) -> PerType:
        slope = jax.grad(energy(start))

        def descend(k: Int[Array, ""], carry: tuple[PerType, PerType]) -> tuple[PerType, PerType]:
            x, way = carry
            ahead = jax.tree.map(lambda x, w: x + energy_guidance.momentum * w, x, way)
            onward = jax.tree.map(
                lambda w, g, mask, by: jnp.where(mask[..., None], energy_guidance.momentum * w - by * g, 0).astype(w.dtype),
                way, slope(ahead), generated, length,
            )  # fmt: skip
            return jax.tree.map(jnp.add, x, onward), onward

        return jax.lax.fori_loop(0, rounds[step], descend, (start, jax.tree.map(jnp.zeros_like, start)))[0]

    def denoise_steered(z: PerType, t: Real[Array, " b"]) -> PerType:
        output = denoise(z, t)
        step = jnp.searchsorted(jnp.asarray(levels.time), t[0])

        def led() -> PerType:
            level = levels[jnp.broadcast_to(step, t.shape)]
            guess = estimate_x0(level, z, output, prediction)
            x0 = jax.tree.map(lambda x, clean, mask: jnp.where(mask[..., None], x, clean), guess, z, generated)
            return output_for(level, z, descended(x0, step), prediction)

        return jax.lax.cond(rounds[step] > 0, led, lambda: output)

    return denoise_steered
