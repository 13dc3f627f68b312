"""What a camera looks at: a log whose heights and sizes are all known."""

from __future__ import annotations

import copy
import dataclasses
import functools
from typing import Any

import numpy as np
from jaxtyping import Float64

from scjax.scene import NO_EGO, Log, Map, Scene, map_to_log, scene_to_map, validate_log
from scjax.scene.agent_sizes import CLASS_SIZES

OTHER_SIZE = (1.0, 1.0, 1.0)  # m, of objects of no ``AgentType``
SNAP_DISTANCE = 0.6  # m


def camera_log(source: Scene | Map | Log) -> Log:
    """The log that a scene, map or log stands for; of one step for the first two. The ego of a scene is its agent 0.

    Raises:
      ValueError: on a batch of scenes or an invalid log.
    """
    if isinstance(source, Log):
        return validate_log(source)
    if isinstance(source, Map):
        return map_to_log(source)
    log = map_to_log(scene_to_map(source))
    return dataclasses.replace(log, ego_index=0 if log.num_objects else NO_EGO)


def carrier_index(log: Log, actor: int | None) -> int:
    """The object that carries the cameras: ``actor``, or the ego.

    Raises:
      ValueError: there is no such object, or no ego.
    """
    index = log.ego_index if actor is None else actor
    if actor is None and index == NO_EGO:
        raise ValueError(
            f"there is no ego to carry the camera: choose one of the {log.num_objects} objects (actor), or give poses"
        )
    if not 0 <= index < log.num_objects:
        raise ValueError(f"actor is {index}: give one of the {log.num_objects} objects, counted from 0")
    if not log.valid[index].any():
        raise ValueError(f"actor is {index}, but object {log.object_ids[index]!r} is valid at no step: choose another")
    return index


def known_sizes(log: Log) -> Float64[np.ndarray, "N 3"]:
    """Length, width and height of all objects [m]; unknown ones are the means of their class."""
    kinds = np.asarray(log.object_types)
    usual = np.tile(np.array(OTHER_SIZE, np.float64), (len(kinds), 1))
    for kind, size in CLASS_SIZES.items():
        usual[kinds == kind] = size
    return np.where(np.isfinite(log.sizes), log.sizes, usual)


@dataclasses.dataclass(frozen=True)
class _LanePoints:
    """Points of lanes, which are searched only where needed."""

    points: Float64[np.ndarray, "n 3"]

    @functools.cached_property
    def tree(self) -> Any:
        from scipy.spatial import KDTree

        return KDTree(self.points[:, :2])


class LogGround:
    """Height of the ground of a log.

    Lanes say how high it is around them. Where they have no z, it is level at the height of the carrier at each step.

    Args:
      log: that is looked at.
      level: height of the ground at each step where no lane has a z [m].
    """

    def __init__(self, log: Log, level: Float64[np.ndarray, " T"]):
        self.level = level
        points = [lane.points for lane in log.lanes if np.isfinite(lane.points[:, 2]).all()]
        self._lanes = _LanePoints(np.concatenate(points)) if points else None

    def at_level(self, level: Float64[np.ndarray, " T"]) -> LogGround:
        """The same ground at another height where no lane has a z."""
        other = copy.copy(self)
        other.level = level
        return other

    def heights(self, places: Float64[np.ndarray, "n 2"], step: int) -> Float64[np.ndarray, " n"]:
        """Height at places of the plane [m]: that of the nearest point of a lane."""
        if self._lanes is None:
            return np.full(len(places), self.level[step])
        return self._lanes.points[self._lanes.tree.query(places)[1], 2]


def ground_of(log: Log, index: int = NO_EGO, known_ground: LogGround | None = None) -> LogGround:
    """The ground of a log around the object ``index``, which stands on it where its z is known.

    Args:
      known_ground: of the log around another object, which saves time.
    """
    level = _ground_level(log, index)
    return LogGround(log, level) if known_ground is None else known_ground.at_level(level)


def _ground_level(log: Log, index: int) -> Float64[np.ndarray, " T"]:
    heights = np.full(log.num_steps, np.nan)
    if index != NO_EGO:
        height = log.sizes[index, 2] if np.isfinite(log.sizes[index, 2]) else known_sizes(log)[index, 2]
        heights = np.where(log.valid[index], log.positions[index, :, 2] - height / 2, np.nan)
    known = np.isfinite(heights)
    if not known.any():
        bottoms = log.positions[..., 2] - known_sizes(log)[:, 2:] / 2
        bottoms = bottoms[log.valid & np.isfinite(bottoms)]
        return np.full(log.num_steps, np.median(bottoms) if len(bottoms) else 0.0)
    steps = np.arange(log.num_steps)
    return np.interp(steps, steps[known], heights[known])
