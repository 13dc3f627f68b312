"""Driving policies: (observation, state) -> (action, state), pure functions in JAX."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Float

from scjax.scene.scene import AnyArray
from scjax.sim.bicycle import Action
from scjax.sim.driver import NORMAL, DriverSettings, idm_acceleration
from scjax.sim.observation import FAR, ROUTE_DISTANCES, Observation

_SIDE_GAP, _STANDING_SIDE_GAP = 0.3, 0.0  # m beside bodies on the way that move, and that stand
_END_GAP = 0.3  # m around them
_FINE, _SPACING = 3, 1.0  # points of the way for each that is seen, and m between them
_LOOK_AHEAD, _MIN_LOOK_AHEAD = 0.8, 4.0  # s and m ahead of the center to which the vehicle steers
_PREDICTED = (0.0, 1.0, 2.0)  # s, at which others must not be on the way


@runtime_checkable
class Policy(Protocol):
    """Drives one agent. Pure and hashable, such as a frozen dataclass or a function."""

    def __call__(self, observation: Observation, state: Any) -> tuple[Action, Any]:
        """The action of this step, and the policy's memory for the next one."""
        ...


@dataclasses.dataclass(frozen=True)
class RoutePolicy:
    """Steers to a point of the route and brakes for what it sees on it: a baseline that reads observations alone."""

    driver: DriverSettings = NORMAL

    def __call__(self, observation: Observation, state: Any = None) -> tuple[Action, Any]:
        """See ``Policy``."""
        speed, route = observation.speed, observation.route
        gap, lead_speed = _body_on_route(observation)
        ahead = jnp.asarray(ROUTE_DISTANCES)
        limit = jnp.sqrt(route[:, 2] ** 2 * self.driver.speed_factor**2 + 2 * self.driver.deceleration * ahead)
        limit = jnp.where(observation.route_mask, limit, jnp.inf).min()
        limit = jnp.where(jnp.isfinite(limit), limit, 0.1)
        free = idm_acceleration(self.driver, speed, limit, gap, lead_speed)
        braking = speed * speed / (2 * self.driver.deceleration)
        stop = jnp.where(observation.stop_distance < FAR, observation.stop_distance, jnp.inf)
        stop = jnp.where(braking > 1.5 * stop + 1.0, jnp.inf, jnp.maximum(stop - 0.5, 0.1))
        red = idm_acceleration(self.driver, speed, limit, stop, jnp.zeros_like(speed))
        return Action(jnp.minimum(free, red), _pursuit(observation)), state


def _pursuit(observation: Observation) -> Float[AnyArray, ""]:
    """Curvature of the circle from the rear axle to a point of the route ahead [1/m]."""
    base = 0.3 * observation.size[0]
    target = jnp.maximum(_LOOK_AHEAD * observation.speed, _MIN_LOOK_AHEAD)
    distance = jnp.hypot(observation.route[:, 0], observation.route[:, 1])
    usable = observation.route_mask & (observation.route[:, 0] > 1.0)
    choice = jnp.argmin(jnp.where(usable, jnp.abs(distance - target), jnp.inf))
    x, y = observation.route[choice, 0] + base, observation.route[choice, 1]
    curvature = 2 * y / jnp.maximum(x * x + y * y, 1.0)
    return jnp.where(usable.any(), curvature, 0.0)


def _body_on_route(observation: Observation) -> tuple[Float[AnyArray, ""], Float[AnyArray, ""]]:
    """Gap [m] to the first body that is on the route or will be, and its speed along the route [m/s]."""
    x, y, cos, sin, speed, length, width = observation.agents.T[:, None]  # [1, agents], beside points of the route
    ahead = jnp.linspace(0.0, ROUTE_DISTANCES[-1], _FINE * (len(ROUTE_DISTANCES) - 1) + 1)
    route = jnp.stack([jnp.interp(ahead, ROUTE_DISTANCES, column) for column in observation.route[:, :2].T], -1)
    is_way = ahead < jnp.where(observation.route_mask, jnp.asarray(ROUTE_DISTANCES), -1.0).max() + 0.1
    step = jnp.diff(route, axis=0)
    step = jnp.concatenate([step, step[-1:]])
    tangent = step / jnp.maximum(jnp.linalg.norm(step, axis=-1, keepdims=True), 1e-3)
    room = 0.5 * observation.size[1] + jnp.where(speed > 0.3, _SIDE_GAP, _STANDING_SIDE_GAP)
    gap, lead = jnp.full_like(observation.speed, jnp.inf), jnp.zeros_like(observation.speed)
    for seconds in _PREDICTED:
        # Where somebody will be counts only for those who cross the route.
        d_x = route[:, None, 0] - (x + seconds * speed * cos)
        d_y = route[:, None, 1] - (y + seconds * speed * sin)
        parallel = tangent[:, :1] * cos + tangent[:, 1:] * sin
        across = jnp.sqrt(jnp.maximum(1.0 - parallel * parallel, 0.0))
        ahead_gap = jnp.abs(d_x * cos + d_y * sin) - 0.5 * length - room * across
        side_gap = jnp.abs(d_y * cos - d_x * sin) - 0.5 * width - room * jnp.abs(parallel)
        counts = observation.agent_mask[None] & is_way[:, None] & (x > 0.0)
        counts = counts & ((seconds == 0.0) | (jnp.abs(parallel) < 0.8))
        hit = jnp.where((jnp.maximum(ahead_gap, side_gap) < _END_GAP) & counts, ahead[:, None], jnp.inf)
        first = hit.min(0)
        row = jnp.argmin(first)
        its_gap = jnp.maximum(first[row] - 0.5 * observation.size[0] - _SPACING + _END_GAP, 0.1)
        its_speed = jnp.maximum(speed[0, row] * parallel[jnp.argmin(hit[:, row]), row], 0.0)
        nearer = its_gap < gap
        gap, lead = jnp.where(nearer, its_gap, gap), jnp.where(nearer, its_speed, lead)
    return gap, lead
