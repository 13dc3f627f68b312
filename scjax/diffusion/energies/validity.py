"""What a scene can be faulted for by itself, as energies that fall as it is mended: joints, overlaps, stray vehicles.

In square metres, so that their gradient is a way in metres, and differentiable almost everywhere. Unlike those of
``consistency`` they need no scene to compare with. Not in the paper.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.scene import AgentType, AnyArray, Link, Scene
from scjax.scene.geometry import distance_to_polylines

_WIDE = 5.0  # m; beyond that an energy rises linearly: so wide a gap is rather a false link
_DRIVES = 1.0  # m/s
_BESIDE_LANE = {"driving": 1.0, "standing": 4.0}  # m; nearer are 97 and 99 % of synthetic ones, 91 and 100 % of real


def energy(scene: Scene) -> Float[Array, " b"]:
    """What estimates are steered by. Strays weigh half: of two on one spot of a lane, parting them comes first."""
    return connection_energy(scene) + overlap_energy(scene) + 0.5 * off_lane_energy(scene)


def connection_energy(scene: Scene) -> Float[Array, " b"]:
    """Half the squared gap, in xy, from the end of every lane to the start of every lane that it leads to; summed."""
    lanes = jnp.asarray(scene.lanes)[..., :2]
    square = jnp.square(lanes[:, None, :, 0] - lanes[:, :, None, -1]).sum(-1)
    linked = (scene.links == Link.PREDECESSOR) & scene.lane_mask[:, :, None] & scene.lane_mask[:, None]
    return jnp.where(linked, _levelled(square), 0).sum((1, 2))


def overlap_energy(scene: Scene, *, air: float = 0.2) -> Float[Array, " b"]:
    """Half the squared depth by which boxes, ``air`` [m] of distance wanted, stand in each other; summed over pairs.

    The depth is the least way that parts two boxes along an axis of either. Only centres receive gradients: boxes
    neither shrink nor turn.
    """
    agents, mask = jnp.asarray(scene.agents), jnp.asarray(scene.agent_mask)
    depth = overlap_depth(agents) + air
    pairs = mask[:, :, None] & mask[:, None] & ~jnp.eye(mask.shape[1], dtype=bool)[None]
    return 0.25 * jnp.where(pairs, jnp.square(jax.nn.relu(depth)), 0).sum((1, 2))  # every pair is met twice


def off_lane_energy(scene: Scene) -> Float[Array, " b"]:
    """Half the squared distance of vehicles from the nearest lane, as far as it exceeds what is usual; summed.

    That is 1 m for driving vehicles and 4 m for standing ones, which park. Only their centres receive gradients.
    """
    lanes, speed = (jax.lax.stop_gradient(jnp.asarray(x)) for x in (scene.lanes, scene.agents[..., 3]))
    apart = distance_to_polylines(jnp.asarray(scene.agents)[..., :2], lanes, scene.lane_mask).min(-1, initial=jnp.inf)
    usual = jnp.where(speed > _DRIVES, _BESIDE_LANE["driving"], _BESIDE_LANE["standing"])
    vehicles = scene.agent_mask & (scene.agent_types == AgentType.VEHICLE) & jnp.isfinite(apart)
    excess = jax.nn.relu(jnp.where(vehicles, apart, 0) - usual)
    return _levelled(jnp.square(excess)).sum(1)


def _levelled(square: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Half of ``square`` [m^2], where that is small; linear in its root beyond ``_WIDE``."""
    return _WIDE**2 * (jnp.sqrt(1 + square / _WIDE**2) - 1)


def overlap_depth(agents: Float[AnyArray, "b n 9"]) -> Float[Array, "b n n"]:
    """How far two boxes would have to move apart until they only touch [m]; negative where there is room.

    ``metrics.boxes.overlaps`` tests the same on the host, exactly; here it has a gradient.
    """
    centres = agents[..., :2]
    ahead, size = (jax.lax.stop_gradient(x) for x in (agents[..., 4:6], agents[..., 6:8]))
    axes = jnp.stack([ahead, jnp.stack([-ahead[..., 1], ahead[..., 0]], -1)], -2)  # [b, n, 2 axes, xy]
    apart = centres[:, None] - centres[:, :, None]
    away = jnp.abs(jnp.einsum("bijx,biax->bija", apart, axes))
    cosines = jnp.abs(jnp.einsum("biax,bjcx->bijac", axes, axes))
    reach = size[:, :, None] / 2 + jnp.einsum("bijac,bjc->bija", cosines, size / 2)
    depth = (reach - away).min(-1)  # along the axes of the first box
    return jnp.minimum(depth, depth.swapaxes(1, 2))
