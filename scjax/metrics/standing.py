"""Vehicles that stand for long without a reason."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from scjax.metrics.object_boxes import ObjectBoxes, center_distances
from scjax.scene import AgentType, Log, Signal
from scjax.scene.angles import wrap_to_pi
from scjax.scene.stop_points import stop_points

_STANDING, _MOVING = 0.1, 0.5  # m/s
_SECONDS = 10.0
_LEADER_GAP = 10.0  # m from the front of a vehicle to an object that it waits for
_STOP_GAP = (-2.0, 20.0)  # m from the front of a vehicle to the stop point of a signal that it waits for
_HALF_LANE, _MAX_ANGLE = 1.75, np.deg2rad(45.0)
_ON_LANE = 1.0  # m from a centerline; vehicles that park are farther


def stuck_vehicles(
    log: Log, boxes: ObjectBoxes, lane_distances: Float64[np.ndarray, "N T"]
) -> tuple[Bool[np.ndarray, " N"], Bool[np.ndarray, " N"]]:
    """Which vehicles are stuck, and which are there for long enough to tell.

    A vehicle is stuck if it stands (below 0.1 m/s) for more than 10 s without a break, and at none of these steps has a
    reason to wait:

    - a leader: an object that overlaps its track straight ahead, at most 10 m before its front;
    - a signal: a stop point from 2 m behind to 20 m before its front, within 1.75 m of its track and 45 degrees of its
      heading, with a signal of STOP or CAUTION there.

    Vehicles that never moved count only while they stand within 1 m of a centerline: others are parked.

    Args:
      lane_distances: from the centers to the nearest centerline [m].
    """
    pause = np.concatenate([np.diff(log.timestamps), [0.0]])
    vehicle = boxes.types == AgentType.VEHICLE
    speeds = np.hypot(*np.moveaxis(log.velocities, -1, 0))
    moved = np.maximum.accumulate((speeds > _MOVING) & boxes.valid, axis=1)
    stands = boxes.valid & vehicle[:, None] & (speeds < _STANDING) & (moved | (lane_distances < _ON_LANE))
    stuck = np.zeros(len(boxes.types), bool)
    rows = np.flatnonzero(_longest(stands, pause) > _SECONDS)
    for row in rows.tolist():  # few stand for long
        waits = _has_leader(boxes, row) | _has_signal(log, boxes, row)
        stuck[row] = _longest((stands[row] & ~waits)[None], pause)[0] > _SECONDS
    return stuck, _longest(boxes.valid, pause) > _SECONDS


def _longest(flags: np.ndarray, pause: np.ndarray) -> np.ndarray:
    """Longest time for which flags [N, T] are True without a break [s]."""
    times = np.concatenate([[0.0], np.cumsum(pause)[:-1]])
    starts = flags & ~np.concatenate([np.zeros((len(flags), 1), bool), flags[:, :-1]], 1)
    begin = np.maximum.accumulate(np.where(starts, times, -np.inf), axis=1)
    return np.where(flags, times - begin, 0.0).max(-1, initial=0.0)


def _has_leader(boxes: ObjectBoxes, row: int) -> np.ndarray:
    """Whether an object stands or drives right before another one, at each step [T]."""
    apart = center_distances(boxes, np.array([row]))[0]
    outer = np.linalg.norm(boxes.half, axis=-1)
    near = apart < _LEADER_GAP + boxes.half[row, 0] + outer[:, None]
    other, step = np.nonzero(near)
    offset = boxes.positions[other, step] - boxes.positions[row, step]
    cos, sin = np.cos(boxes.headings[row, step]), np.sin(boxes.headings[row, step])
    turn = boxes.headings[other, step] - boxes.headings[row, step]
    along, across = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    length, width = boxes.half[other].T
    ahead = offset[:, 0] * cos + offset[:, 1] * sin
    gap = ahead - boxes.half[row, 0] - length * along - width * across
    side = np.abs(offset[:, 1] * cos - offset[:, 0] * sin) - boxes.half[row, 1] - length * across - width * along
    leader = np.zeros(boxes.valid.shape[1], bool)
    leader[step[(ahead > 0) & (gap < _LEADER_GAP) & (side < 0)]] = True
    return leader


def _has_signal(log: Log, boxes: ObjectBoxes, row: int) -> np.ndarray:
    """Whether a signal ahead of an object is STOP or CAUTION, at each step [T]."""
    points = stop_points(log)
    waits = np.zeros(boxes.valid.shape[1], bool)
    if not len(points.signals):
        return waits
    ahead = np.stack([np.cos(boxes.headings[row]), np.sin(boxes.headings[row])], -1)
    offset = points.positions[:, None] - (boxes.positions[row] + boxes.half[row, 0] * ahead)  # [points, T, 2]
    gap = (offset * ahead).sum(-1)
    side = np.abs(offset[..., 1] * ahead[:, 0] - offset[..., 0] * ahead[:, 1])
    directions = np.arctan2(points.directions[:, 1], points.directions[:, 0])
    turn = np.abs(wrap_to_pi(boxes.headings[row] - directions[:, None]))
    near = (gap > _STOP_GAP[0]) & (gap < _STOP_GAP[1]) & (side < _HALF_LANE) & (turn < _MAX_ANGLE)
    lit = np.isin(log.signal_states[points.signals], (Signal.STOP, Signal.CAUTION))
    return (near & lit).any(0)
