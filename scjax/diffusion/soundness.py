"""What a scene can be faulted for by itself, as energies that fall as it is mended: open joints, overlapping boxes.

In square metres, so that half a metre too much matters a quarter of a metre's worth, and differentiable almost
everywhere. Unlike ``consistency`` they need no scene to compare with. Not in the paper.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.scene import AnyArray, Link, Scene

_WIDE = 5.0  # m; beyond that the energy of a joint rises linearly: so wide a gap is rather a false link


def joint_energy(scene: Scene) -> Float[Array, " b"]:
    """Half the squared gap, in xy, from the end of every lane to the start of every lane that it leads to; summed."""
    lanes = jnp.asarray(scene.lanes)[..., :2]
    square = jnp.square(lanes[:, None, :, 0] - lanes[:, :, None, -1]).sum(-1)
    linked = (scene.links == Link.PREDECESSOR) & scene.lane_mask[:, :, None] & scene.lane_mask[:, None]
    energy = _WIDE**2 * (jnp.sqrt(1 + square / _WIDE**2) - 1)
    return jnp.where(linked, energy, 0).sum((1, 2))


def overlap_energy(scene: Scene, *, air: float = 0.2) -> Float[Array, " b"]:
    """Half the squared depth by which boxes, ``air`` [m] of distance wanted, stand in each other; summed over pairs.

    The depth is the least way that parts two boxes along an axis of either. Only centres receive gradients: boxes
    neither shrink nor turn.
    """
    agents, mask = jnp.asarray(scene.agents), jnp.asarray(scene.agent_mask)
    depth = overlap_depth(agents) + air
    pairs = mask[:, :, None] & mask[:, None] & ~jnp.eye(mask.shape[1], dtype=bool)[None]
    return 0.25 * jnp.where(pairs, jnp.square(jax.nn.relu(depth)), 0).sum((1, 2))  # every pair is met twice


def overlap_depth(agents: Float[AnyArray, "b n 9"]) -> Float[Array, "b n n"]:
    """How far two boxes would have to move apart until they only touch [m]; negative where there is room."""
    centres = agents[..., :2]
    ahead, size = (jax.lax.stop_gradient(x) for x in (agents[..., 4:6], agents[..., 6:8]))
    axes = jnp.stack([ahead, jnp.stack([-ahead[..., 1], ahead[..., 0]], -1)], -2)  # [b, n, 2 axes, xy]
    apart = centres[:, None] - centres[:, :, None]
    away = jnp.abs(jnp.einsum("bijx,biax->bija", apart, axes))
    cosines = jnp.abs(jnp.einsum("biax,bjcx->bijac", axes, axes))
    reach = size[:, :, None] / 2 + jnp.einsum("bijac,bjc->bija", cosines, size / 2)
    depth = (reach - away).min(-1)  # along the axes of the first box
    return jnp.minimum(depth, depth.swapaxes(1, 2))
