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


def decoded_penalty(
    weights: PenaltyWeights,
    base: Model,
    params: Params,
    estimate: PerType,
    level: NoiseLevel,
    masks: PerType,
    scene: Scene,
) -> Float[Array, " b"]:
    """The weighted penalties of the scene that an estimate of x_0 decodes to, one number per scene.

    Args:
      base, params: the frozen autoencoder's model, and its parameters.
      estimate: normalized latents; level: noise from which they were estimated.
      scene: the true scene, in the token order of the estimate.
    """
    latents = base.latents.denormalize(estimate)
    decoded = decode_latents(
        base.autoencoder.config, params["decoder"], base.codec, latents, masks, scene.crop, scene.domain
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
