"""The paper's collision penalty L_col (official-spec §7), as the paper describes it.

The official release reads other columns, rotates by the wrong sign, sums over the batch and trains the frozen decoder.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.diffusion.noise_level import NoiseLevel
from scjax.scene import AgentType, Scene

TAU = 0.1


def collision_energy(scene: Scene, *, tau: float = TAU) -> Float[Array, " b"]:
    """Overlap of vehicle boxes per scene [B], no unit: sum over ordered pairs of tanh(overlap / tau), over 2 n.

    n is the number of vehicles. The overlap of a pair is the shared area of both boxes over the sum of their areas. It
    is measured in the frame of the first box, as if both had its heading. Only centers receive gradients, except that
    of the ego."""
    agents = jnp.asarray(scene.agents)
    counted = jnp.asarray(scene.agent_mask) & (scene.agent_types == AgentType.VEHICLE)
    centers = jnp.concatenate([jax.lax.stop_gradient(agents[:, :1, :2]), agents[:, 1:, :2]], 1)
    cos, sin, length, width = jnp.moveaxis(jax.lax.stop_gradient(agents[..., 4:8]), -1, 0)
    offset = centers[:, None] - centers[:, :, None]  # from the first (row) to the second (column)
    longitudinal = cos[..., None] * offset[..., 0] + sin[..., None] * offset[..., 1]
    lateral = cos[..., None] * offset[..., 1] - sin[..., None] * offset[..., 0]
    shared_area = jax.nn.relu((length[:, :, None] + length[:, None]) / 2 - jnp.abs(longitudinal))
    shared_area = shared_area * jax.nn.relu((width[:, :, None] + width[:, None]) / 2 - jnp.abs(lateral))
    area = length * width
    overlap = shared_area / (area[:, :, None] + area[:, None] + 1e-6)
    pairs = counted[:, :, None] & counted[:, None] & ~jnp.eye(agents.shape[1], dtype=bool)[None]
    total = jnp.where(pairs, jnp.tanh(overlap / tau), 0.0).sum((1, 2))
    return total / (2 * jnp.maximum(counted.sum(-1), 1))


def collision_weight(level: NoiseLevel) -> Float[Array, " b"]:
    """Weight 1 - sigma of the collision loss [B]: near 1 where x0 is almost known, near 0 where it is uncertain."""
    return 1 - jnp.asarray(level.sigma)
