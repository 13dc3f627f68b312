"""The kinematic bicycle that moves driven agents, and its inverse.

Formulas of Waymax's invertible bicycle model: Gulino et al., "Waymax: An accelerated, data-driven simulator for
large-scale autonomous driving research", NeurIPS 2023.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.scene.geometry import wrap_angle
from scjax.scene.scene import AnyArray

MAX_ACCELERATION, MAX_CURVATURE = 6.0, 0.3  # m/s^2, 1/m
_MIN_SPEED = 0.6  # m/s, below which the curvature of a motion is not defined


class Action(NamedTuple):
    """What a driver does in a step: acceleration [m/s^2] and curvature of the path, positive to the left [1/m]."""

    acceleration: Float[AnyArray, "*b"]
    curvature: Float[AnyArray, "*b"]


class VehiclePose(NamedTuple):
    """Center [m], heading [rad] and speed [m/s]."""

    x: Float[AnyArray, "*b"]
    y: Float[AnyArray, "*b"]
    heading: Float[AnyArray, "*b"]
    speed: Float[AnyArray, "*b"]


def bicycle_step(pose: VehiclePose, action: Action, dt: float) -> VehiclePose:
    """The pose ``dt`` seconds later. Actions are clipped to what vehicles can do; nobody drives in reverse."""
    acceleration = jnp.clip(action.acceleration, -MAX_ACCELERATION, MAX_ACCELERATION)
    curvature = jnp.clip(action.curvature, -MAX_CURVATURE, MAX_CURVATURE)
    speed = jnp.maximum(pose.speed + acceleration * dt, 0.0)
    distance = 0.5 * (pose.speed + speed) * dt
    heading = pose.heading + curvature * distance
    middle = pose.heading + 0.5 * curvature * distance
    return VehiclePose(pose.x + distance * jnp.cos(middle), pose.y + distance * jnp.sin(middle), heading, speed)


def bicycle_action(before: VehiclePose, after: VehiclePose, dt: float) -> Action:
    """The action that leads from one pose to the next; 0 curvature for vehicles that hardly move."""
    acceleration = (after.speed - before.speed) / dt
    distance = 0.5 * (before.speed + after.speed) * dt
    turn = wrap_angle(after.heading - before.heading)
    moves = distance > _MIN_SPEED * dt
    return Action(acceleration, jnp.where(moves, turn / jnp.where(moves, distance, 1.0), 0.0))


def finite_action(action: Action) -> Array:
    """Whether both numbers are finite [*b]."""
    return jnp.isfinite(action.acceleration) & jnp.isfinite(action.curvature)
