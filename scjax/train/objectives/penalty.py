"""Training penalties in the decoded scene: overlaps of vehicles, open lane connections, offsets from lanes."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.diffusion.energies.collision import collision_energy, collision_weight
from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.relation_loss import connection_error, lateral_offset_error, relation_weight
from scjax.generate.compiled import decode_latents
from scjax.generate.model import Model
from scjax.nn.functional import Params
from scjax.scene import Scene
from scjax.scene.per_type import PerType


@dataclasses.dataclass(frozen=True)
class PenaltyWeights:
    """Weights of the penalties; 0 leaves one out."""

    collision: float = 0.0
    connections: float = 0.0
    lateral_offsets: float = 0.0

    def __bool__(self) -> bool:
        return bool(self.collision or self.connections or self.lateral_offsets)


@dataclasses.dataclass(frozen=True)
class DecodedPenalty:
    """The weighted penalties of the scenes that estimates of x_0 decode to, beside the true scenes of a batch.

    Attributes:
      base, params: the frozen autoencoder's model, and its parameters.
      masks: True at valid tokens [B, tokens] per type.
      scene: the true scenes [B], in the token order of the estimates.
    """

    weights: PenaltyWeights
    base: Model
    params: Params
    masks: PerType
    scene: Scene

    def __call__(self, estimate: PerType, level: NoiseLevel) -> Float[Array, " b"]:
        """One number per scene, of normalized latents that were estimated at a noise level."""
        weights, base, scene = self.weights, self.base, self.scene
        latents = base.latents.denormalize(estimate)
        decoded = decode_latents(
            base.autoencoder.config, self.params["decoder"], base.codec, latents, self.masks, scene.crop, scene.domain
        )
        total = jnp.zeros(len(scene.crop))
        if weights.collision:
            energy = collision_energy(decoded.replace(agent_types=scene.agent_types))
            total += weights.collision * collision_weight(level) * energy
        if weights.connections:
            total += weights.connections * relation_weight(level) * connection_error(decoded, scene)
        if weights.lateral_offsets:
            total += weights.lateral_offsets * relation_weight(level) * lateral_offset_error(decoded, scene)
        return total
