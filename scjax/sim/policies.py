"""Driving policies: (observation, state) -> (action, state), pure functions in JAX."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from scjax.scene.scene import AnyArray
from scjax.sim.bicycle import Action
from scjax.sim.driver import NORMAL, DriverSettings, idm_acceleration
from scjax.sim.observation import FAR, ROUTE_DISTANCES, Observation

_SIDE_GAP, _STANDING_SIDE_GAP = 0.6, 0.2  # m beside bodies on the way that move, and that stand
_END_GAP = 0.3  # m before and behind them
_FINE, _SPACING = 3, 1.0  # points of the way for each that is seen, and m between them
_LOOK_AHEAD, _MIN_LOOK_AHEAD = 0.4, 2.0  # s and m ahead of the center to which the vehicle steers
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
    route = _fine_route(observation)
    distance = jnp.hypot(route[:, 0], route[:, 1])
    usable = _is_way(observation) & (route[:, 0] > 1.0)
    choice = jnp.argmin(jnp.where(usable, jnp.abs(distance - target), jnp.inf))
    x, y = route[choice, 0] + base, route[choice, 1]
    curvature = 2 * y / jnp.maximum(x * x + y * y, 1.0)
    return jnp.where(usable.any(), curvature, 0.0)


def _body_on_route(observation: Observation) -> tuple[Float[AnyArray, ""], Float[AnyArray, ""]]:
    """Gap [m] to the first body that is on the route or will be, and its speed along the route [m/s]."""
    x, y, cos, sin, speed, length, width = observation.agents.T[:, None]  # [1, agents], beside points of the route
    route, is_way, ahead = _fine_route(observation), _is_way(observation), jnp.asarray(_FINE_DISTANCES)
    step = jnp.diff(route, axis=0)
    step = jnp.concatenate([step, step[-1:]])
    tangent = step / jnp.maximum(jnp.linalg.norm(step, axis=-1, keepdims=True), 1e-3)
    room = 0.5 * observation.size[1] + jnp.where(speed > 0.3, _SIDE_GAP, _STANDING_SIDE_GAP)
    gap, lead = jnp.full_like(observation.speed, jnp.inf), jnp.zeros_like(observation.speed)
    parallel = tangent[:, :1] * cos + tangent[:, 1:] * sin
    along, across = jnp.abs(parallel), jnp.abs(tangent[:, :1] * sin - tangent[:, 1:] * cos)
    for seconds in _PREDICTED:
        # Where somebody will be counts only for those who cross the route.
        d_x = route[:, None, 0] - (x + seconds * speed * cos)
        d_y = route[:, None, 1] - (y + seconds * speed * sin)
        # The slice of the way at each point is a box, as the body is: no edge of either lies between them.
        apart = (
            jnp.abs(d_x * cos + d_y * sin) - 0.5 * length - room * across - _END_GAP * along,
            jnp.abs(d_y * cos - d_x * sin) - 0.5 * width - room * along - _END_GAP * across,
            jnp.abs(d_x * tangent[:, :1] + d_y * tangent[:, 1:]) - 0.5 * (length * along + width * across) - _END_GAP,
            jnp.abs(d_y * tangent[:, :1] - d_x * tangent[:, 1:]) - 0.5 * (length * across + width * along) - room,
        )
        counts = observation.agent_mask[None] & is_way[:, None] & (x > 0.0)
        counts = counts & ((seconds == 0.0) | (along < 0.8))
        hit = jnp.where((jnp.stack(apart).max(0) < 0) & counts, ahead[:, None], jnp.inf)
        first = hit.min(0)
        row = jnp.argmin(first)
        its_gap = jnp.maximum(first[row] - 0.5 * observation.size[0] - _SPACING + _END_GAP, 0.1)
        its_speed = jnp.maximum(speed[0, row] * parallel[jnp.argmin(hit[:, row]), row], 0.0)
        nearer = its_gap < gap
        gap, lead = jnp.where(nearer, its_gap, gap), jnp.where(nearer, its_speed, lead)
    return gap, lead


def _is_way(observation: Observation) -> Bool[AnyArray, " points"]:
    """Which of the points of ``_fine_route`` are on the route."""
    end = jnp.where(observation.route_mask, jnp.asarray(ROUTE_DISTANCES), -1.0).max()
    return jnp.asarray(_FINE_DISTANCES) < end + 0.1


def _fine_route(observation: Observation) -> Float[AnyArray, "points 2"]:
    """Points of the route, ``_SPACING`` apart, on curves through those that are seen: chords would cut bends [m]."""
    mask, points = observation.route_mask, observation.route[:, :2]
    last = points[jnp.maximum(mask.sum() - 1, 0)]
    return jnp.asarray(_BETWEEN) @ jnp.where(mask[:, None], points, last)


def _catmull_rom(count: int, parts: int) -> Float[np.ndarray, "points count"]:
    """Weights of ``count`` points for points on the Catmull-Rom curve through them, ``parts`` from one to the next."""
    position = np.arange(parts * (count - 1) + 1) / parts
    first = np.minimum(position.astype(int), count - 2)
    t = (position - first)[:, None]
    weights = np.concatenate(
        [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2], axis=1
    )
    out = np.zeros((len(position), count), np.float32)
    for offset, weight in zip(range(-1, 3), weights.T / 2, strict=True):
        np.add.at(out, (np.arange(len(position)), np.clip(first + offset, 0, count - 1)), weight)
    return out


_BETWEEN = _catmull_rom(len(ROUTE_DISTANCES), _FINE)
_FINE_DISTANCES = np.linspace(0.0, ROUTE_DISTANCES[-1], len(_BETWEEN)).astype(np.float32)
