"""Energy of vehicles that are too far from every lane. Not in the paper."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.diffusion.energies.pseudo_huber import pseudo_huber
from scjax.scene import AgentType, Scene
from scjax.scene.geometry import distance_to_polylines

_MOVING_SPEED = 1.0  # m/s
# Distances [m] to the nearest lane. 97 % of moving and 99 % of stationary synthetic vehicles are nearer, and 91 % and
# 100 % of recorded ones. Stationary vehicles may be parked.
_USUAL_DISTANCE_MOVING = 1.0
_USUAL_DISTANCE_STATIONARY = 4.0


def off_lane_energy(scene: Scene) -> Float[Array, " b"]:
    """Half the squared excess distance of vehicles from the nearest lane [m^2], summed over vehicles [B].

    The excess is what exceeds 1 m for moving and 4 m for stationary vehicles; beyond 5 m the energy is linear. Only the
    centers of vehicles receive gradients. Scenes without lanes have energy 0.
    """
    lanes, speed = (jax.lax.stop_gradient(jnp.asarray(x)) for x in (scene.lanes, scene.agents[..., 3]))
    centers = jnp.asarray(scene.agents)[..., :2]
    distance = distance_to_polylines(centers, lanes, scene.lane_mask).min(-1, initial=jnp.inf)
    usual = jnp.where(speed > _MOVING_SPEED, _USUAL_DISTANCE_MOVING, _USUAL_DISTANCE_STATIONARY)
    vehicles = scene.agent_mask & (scene.agent_types == AgentType.VEHICLE) & jnp.isfinite(distance)
    excess = jax.nn.relu(jnp.where(vehicles, distance, 0) - usual)
    return pseudo_huber(jnp.square(excess)).sum(1)
