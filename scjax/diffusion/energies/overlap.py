"""Energy of overlapping boxes of agents. Not in the paper; the paper's penalty is ``collision``."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.scene import AnyArray, Scene


def overlap_energy(scene: Scene, *, margin: float = 0.2) -> Float[Array, " b"]:
    """Half the squared penetration depth [m^2], summed over pairs of agents [B].

    Only centers receive gradients: boxes neither shrink nor turn.

    Args:
      margin: required distance between boxes [m].
    """
    agents, mask = jnp.asarray(scene.agents), jnp.asarray(scene.agent_mask)
    depth = overlap_depth(agents) + margin
    pairs = mask[:, :, None] & mask[:, None] & ~jnp.eye(mask.shape[1], dtype=bool)[None]
    return 0.25 * jnp.where(pairs, jnp.square(jax.nn.relu(depth)), 0).sum((1, 2))  # every pair occurs twice


def overlap_depth(agents: Float[AnyArray, "b n 9"]) -> Float[Array, "b n n"]:
    """Penetration depth of two boxes [m]: the shortest move that separates them; negative if they are apart.

    A separating-axis test over the axes of both boxes. ``scene.boxes.overlaps`` is the same test in NumPy, without
    a gradient.
    """
    centers = agents[..., :2]
    heading, size = (jax.lax.stop_gradient(x) for x in (agents[..., 4:6], agents[..., 6:8]))
    axes = jnp.stack([heading, jnp.stack([-heading[..., 1], heading[..., 0]], -1)], -2)  # [b, n, 2 axes, xy]
    offset = centers[:, None] - centers[:, :, None]
    distance = jnp.abs(jnp.einsum("bijx,biax->bija", offset, axes))
    cosines = jnp.abs(jnp.einsum("biax,bjcx->bijac", axes, axes))
    reach = size[:, :, None] / 2 + jnp.einsum("bijac,bjc->bija", cosines, size / 2)
    depth = (reach - distance).min(-1)  # along the axes of the first box
    return jnp.minimum(depth, depth.swapaxes(1, 2))
