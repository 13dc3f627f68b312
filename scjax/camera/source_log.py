"""What a camera looks at: a log whose heights and sizes are all known."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64

from scjax.scene import NO_EGO, AgentType, Log, Map, Scene, map_to_log, scene_to_map, validate_log
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
    usual = [
        CLASS_SIZES[AgentType(kind)] if kind >= 0 else OTHER_SIZE for kind in np.asarray(log.object_types).tolist()
    ]
    return np.where(np.isfinite(log.sizes), log.sizes, np.array(usual, np.float64).reshape(-1, 3))


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
        self._points = np.concatenate(points) if points else None
        self._tree = None

    def heights(self, places: Float64[np.ndarray, "n 2"], step: int) -> Float64[np.ndarray, " n"]:
        """Height at places of the plane [m]: that of the nearest point of a lane."""
        if self._points is None:
            return np.full(len(places), self.level[step])
        if self._tree is None:
            from scipy.spatial import KDTree

            self._tree = KDTree(self._points[:, :2])
        return self._points[self._tree.query(places)[1], 2]


def ground_of(log: Log, index: int = NO_EGO) -> LogGround:
    """The ground of a log around the object ``index``, which stands on it where its z is known."""
    heights = np.full(log.num_steps, np.nan)
    if index != NO_EGO:
        height = log.sizes[index, 2] if np.isfinite(log.sizes[index, 2]) else known_sizes(log)[index, 2]
        heights = np.where(log.valid[index], log.positions[index, :, 2] - height / 2, np.nan)
    known = np.isfinite(heights)
    if not known.any():
        bottoms = log.positions[..., 2] - known_sizes(log)[:, 2:] / 2
        bottoms = bottoms[log.valid & np.isfinite(bottoms)]
        return LogGround(log, np.full(log.num_steps, np.median(bottoms) if len(bottoms) else 0.0))
    steps = np.arange(log.num_steps)
    return LogGround(log, np.interp(steps, steps[known], heights[known]))
