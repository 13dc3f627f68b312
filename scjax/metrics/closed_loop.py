"""Closed-loop metrics of a roll-out: collisions, off-road, red lights, progress and motion distributions.

Definitions: metrics.md §6. NumPy arrays [steps, agents] in the frame of the scene. ``driving`` measures logs of whole
maps by other definitions.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.metrics.distances import jensen_shannon, moments
from scjax.metrics.distributions import Sums
from scjax.metrics.lanes import lane_segments, nearest_segment
from scjax.metrics.pooling import Values, ratio, singles
from scjax.scene import AgentType, Scene, Signal
from scjax.scene.boxes import overlaps

BINS = 200
RANGES = {"speed": (0.0, 30.0), "angular_speed": (-50.0, 50.0), "acceleration": (-10.0, 10.0), "nearest": (0.0, 40.0)}
"""Ranges of the motion histograms [m/s, degrees/s, m/s^2, m]."""

_OFF_ROAD = 3.0  # metres from the nearest centreline
_STOP_WIDTH, _STOP_ANGLE = 1.75, np.deg2rad(45.0)  # stop line: half width [m], largest angle of a crossing vehicle
_MOVING = 0.5  # m/s
_STUCK_SPEED, _STUCK_SECONDS = 0.3, 5.0  # m/s; seconds at the end of the roll-out
# The reference code's bins are too wide by 100 / upper end; its angular speed is heading / dt.
_COMPAT_EDGES = {
    "speed": np.arange(BINS + 1) * 0.5 * (100 / 30),
    "angular_speed": np.arange(BINS + 1) * 0.5 - 50,
    "acceleration": np.arange(BINS + 1) * 0.1 - 10,
    "nearest": np.arange(BINS + 1) * 0.5 * (100 / 40),
}


@dataclasses.dataclass(frozen=True)
class Rollout:
    """Trajectories of the agents of one scene; agent 0 is the ego.

    Attributes:
      states: x, y [m], heading [rad], speed [m/s]; [steps, agents, 4].
      valid: [steps, agents], False where an agent is absent.
      sizes: length and width [m], [agents, 2].
      types: ``AgentType`` [agents].
      dt: duration of a step [s].
      signals: ``Signal`` of every lane at each step [steps, lanes]; None: the signals of the scene at all steps.
    """

    states: np.ndarray
    valid: np.ndarray
    sizes: np.ndarray
    types: np.ndarray
    dt: float = 0.1
    signals: np.ndarray | None = None

    def __post_init__(self):
        steps, agents = self.valid.shape
        if self.states.shape != (steps, agents, 4) or self.sizes.shape != (agents, 2) or self.types.shape != (agents,):
            raise ValueError(
                f"a roll-out of {steps} steps and {agents} agents (valid) needs states [{steps}, {agents}, 4], sizes "
                f"[{agents}, 2] and types [{agents}], not {self.states.shape}, {self.sizes.shape}, {self.types.shape}"
            )
        if not self.dt > 0:
            raise ValueError(f"dt is {self.dt}: give the duration of a step in seconds")
        invalid = self.valid & ~np.isfinite(self.states).all(-1)
        if invalid.any():
            step, agent = np.argwhere(invalid)[0]
            raise ValueError(f"states[{step}, {agent}] holds NaN or infinity where valid is True: clear the flag there")


def rollout_sums(rollout: Rollout, scene: Scene) -> Sums:
    """Contribution of one roll-out of one scene: (numerator, denominator) [2] and moments [3].

    Returns:
      ego_collision: scenes in which the ego overlaps another agent at any step / scenes.
      collision: agents that overlap another at any step / agents. vehicle_collision: the same among vehicles.
      off_road: vehicles more than 3 m from a centerline at any step / vehicles that started on the road.
      red_light: vehicles that enter a lane at its start while its signal is STOP / vehicles.
      stuck: vehicles that moved before but stand for the last 5 s / vehicles.
      progress: moments of the distances that vehicles drive [m]. ego_progress: of the ego.
    """
    (scene,) = singles(scene)
    present = np.asarray(rollout.valid.any(0))
    vehicle = np.asarray(present & (rollout.types == AgentType.VEHICLE))
    hit, hit_vehicle = _collisions(rollout)
    off, began = _off_road(rollout, scene)
    drove = _progress(rollout)
    ego = vehicle[:1].any() if len(vehicle) else False

    def share(flags: np.ndarray, among: np.ndarray) -> np.ndarray:
        return np.array([float((flags & among).sum()), float(among.sum())])

    return {
        "ego_collision": np.array([float(hit[:1].any()), float(present[:1].any())]),
        "collision": share(hit, present),
        "vehicle_collision": share(hit_vehicle, vehicle),
        "off_road": share(off, vehicle & began),
        "red_light": share(_red_light(rollout, scene), vehicle),
        "stuck": share(_stuck(rollout), vehicle),
        "progress": moments(drove[vehicle]),
        "ego_progress": moments(drove[:1] if ego else drove[:0]),
    }


def motion_sums(rollout: Rollout, mode: Literal["intended", "compat"] = "intended") -> Sums:
    """Histograms of speed, angular speed, acceleration and distance to the nearest vehicle, over vehicles and steps."""
    vehicle = rollout.types == AgentType.VEHICLE
    states, valid = rollout.states[:, vehicle].astype(np.float64), rollout.valid[:, vehicle]
    both = valid[1:] & valid[:-1]
    turned = np.diff(states[..., 2], axis=0)
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    angular = turned / rollout.dt if mode == "intended" else states[1:, :, 2] / rollout.dt
    values = {
        "speed": states[..., 3][valid],
        "angular_speed": np.degrees(angular)[both],
        "acceleration": (np.diff(states[..., 3], axis=0) / rollout.dt)[both],
        "nearest": _nearest(states, valid),
    }
    return {f"{name}_motion": _histogram(name, values, mode) for name, values in values.items()}


def rollout_table(sums: Sums) -> Values:
    """Percentages and mean progress [m] from the added sums of ``rollout_sums``; NaN where nothing was counted."""
    row = {}
    for name, value in sums.items():
        if value.shape == (2,):
            row[name] = 100 * ratio(float(value[0]), float(value[1]))
        elif value.shape == (3,):
            row[name] = ratio(float(value[1]), float(value[0]))
    return row


def motion_table(simulated: Sums, logged: Sums) -> Values:
    """Jensen-Shannon divergences (natural logarithm) between the added ``motion_sums`` of two sides."""
    return {name: jensen_shannon(simulated[f"{name}_motion"], logged[f"{name}_motion"]) for name in RANGES}


def _histogram(name: str, values: np.ndarray, mode: str) -> np.ndarray:
    low, high = RANGES[name]
    edges = np.linspace(low, high, BINS + 1) if mode == "intended" else _COMPAT_EDGES[name]
    return np.histogram(np.clip(values, low, high), edges)[0].astype(np.float64)


def _nearest(states: np.ndarray, valid: np.ndarray) -> np.ndarray:
    if states.shape[1] < 2:
        return np.zeros(0)
    apart = np.linalg.norm(states[:, :, None, :2] - states[:, None, :, :2], axis=-1)
    apart[~(valid[:, :, None] & valid[:, None])] = np.inf
    apart[:, np.arange(states.shape[1]), np.arange(states.shape[1])] = np.inf
    nearest = apart.min(-1)
    return nearest[np.isfinite(nearest)]


def _collisions(rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Agents that overlap another at any step [agents], and vehicles that overlap a vehicle [agents]."""
    hit, among = np.zeros(len(rollout.types), bool), np.zeros(len(rollout.types), bool)
    vehicle = rollout.types == AgentType.VEHICLE
    for states, valid in zip(rollout.states, rollout.valid, strict=True):
        rows = np.flatnonzero(valid)
        boxes = np.zeros((len(rows), 9))
        boxes[:, :2], boxes[:, 6:8] = states[rows, :2], rollout.sizes[rows]
        boxes[:, 4], boxes[:, 5] = np.cos(states[rows, 2]), np.sin(states[rows, 2])
        pairs = overlaps(boxes)
        hit[rows] |= pairs.any(1)
        cars = vehicle[rows]
        among[rows] |= (pairs & cars[:, None] & cars[None]).any(1)
    return hit, among


def _off_road(rollout: Rollout, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Agents off the road at any step [agents], and agents on the road at their first step [agents]."""
    steps, agents = rollout.valid.shape
    distance = nearest_segment(rollout.states[..., :2].reshape(-1, 2), lane_segments(scene))[0].reshape(steps, agents)
    off = rollout.valid & (distance > _OFF_ROAD)
    first = rollout.valid.argmax(0)
    return np.asarray(off.any(0)), np.asarray(~off[first, np.arange(agents)] & rollout.valid.any(0))


def _red_light(rollout: Rollout, scene: Scene) -> np.ndarray:
    """Agents whose center crosses the start of a lane, in driving direction, while its signal is STOP [agents]."""
    lanes = np.asarray(scene.lanes, np.float64)[..., :2]
    crossed = np.zeros(len(rollout.types), bool)
    signals = rollout.signals if rollout.signals is not None else np.tile(scene.signals, (len(rollout.states), 1))
    if not len(lanes) or not (signals == Signal.STOP).any():
        return crossed
    along = lanes[:, 1] - lanes[:, 0]
    heading = np.arctan2(along[:, 1], along[:, 0])
    ahead = np.stack([np.cos(heading), np.sin(heading)], -1)
    apart = rollout.states[:, :, None, :2] - lanes[:, 0]
    way = (apart * ahead).sum(-1)
    side = np.abs(apart[..., 1] * ahead[:, 0] - apart[..., 0] * ahead[:, 1])
    turn = (rollout.states[:, :, None, 2] - heading + np.pi) % (2 * np.pi) - np.pi
    fits = (side < _STOP_WIDTH) & (np.abs(turn) < _STOP_ANGLE) & (rollout.states[..., 3] > _MOVING)[..., None]
    passes = (way[:-1] < 0) & (way[1:] >= 0) & fits[1:] & (signals[:-1] == Signal.STOP)[:, None]
    both = rollout.valid[:-1] & rollout.valid[1:]
    return (passes.any(-1) & both).any(0)


def _progress(rollout: Rollout) -> np.ndarray:
    """Distance that each agent drives [m]."""
    step = np.linalg.norm(np.diff(rollout.states[..., :2], axis=0), axis=-1)
    return np.where(rollout.valid[:-1] & rollout.valid[1:], step, 0.0).sum(0)


def _stuck(rollout: Rollout) -> np.ndarray:
    last = max(1, round(_STUCK_SECONDS / rollout.dt))
    if len(rollout.states) <= last:
        return np.zeros(len(rollout.types), bool)
    speed, valid = rollout.states[..., 3], rollout.valid
    stands = ((speed[-last:] < _STUCK_SPEED) & valid[-last:]).all(0)
    return np.asarray(stands & ((speed[:-last] > _MOVING) & valid[:-last]).any(0))
