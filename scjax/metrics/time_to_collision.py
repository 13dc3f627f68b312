"""Time until an object meets the one that it follows, as the Waymo Open Sim Agents Challenge defines it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

from scjax.metrics.object_boxes import ObjectBoxes
from scjax.scene.angles import wrap_to_pi

MAX_TIME_TO_COLLISION = 5.0
"""Larger times, and those of objects that follow nobody, are this [s]."""

_MAX_ANGLE = np.deg2rad(75.0)  # between an object and the one that it follows
_MAX_ANGLE_BESIDE = np.deg2rad(10.0)  # the same where they overlap by less than _SMALL_OVERLAP from side to side
_SMALL_OVERLAP = 0.5  # m


def times_to_collision(
    boxes: ObjectBoxes,
    rows: Int[np.ndarray, " rows"],
    apart: Float64[np.ndarray, "rows N T"],
    speeds: Float64[np.ndarray, "N T"],
) -> Float64[np.ndarray, "rows T"]:
    """Gap / difference of speeds to the nearest object ahead in the own track, for some objects [s].

    An object follows another one that is wholly ahead of its front, within its width, and within 75 degrees of its
    heading; within 10 degrees if they overlap by less than 0.5 m from side to side.

    Args:
      rows: the objects.
      apart: of ``center_distances``.
      speeds: of ``kinematics`` [m/s], NaN where not known.
    """
    result = np.full((len(rows), boxes.valid.shape[1]), MAX_TIME_TO_COLLISION)
    outer = np.linalg.norm(boxes.half, axis=-1)
    own_speeds = np.nan_to_num(speeds[rows])
    # Objects beyond this distance are reached after the longest time at best, so they change nothing.
    reach = MAX_TIME_TO_COLLISION * own_speeds + boxes.half[rows, :1]
    near = (apart - outer[:, None] < reach[:, None]) & (own_speeds > 0)[:, None]
    row, other, step = np.nonzero(near)
    own = rows[row]
    offset = boxes.positions[other, step] - boxes.positions[own, step]
    cos, sin = np.cos(boxes.headings[own, step]), np.sin(boxes.headings[own, step])
    turn = np.abs(wrap_to_pi(boxes.headings[other, step] - boxes.headings[own, step]))
    along, across = np.abs(np.cos(turn)), np.sin(turn)
    length, width = boxes.half[other].T
    gap = offset[:, 0] * cos + offset[:, 1] * sin - boxes.half[own, 0] - length * along - width * across
    side = np.abs(offset[:, 1] * cos - offset[:, 0] * sin) - boxes.half[own, 1] - length * across - width * along
    follows = (gap > 0) & (turn <= _MAX_ANGLE) & (side < 0)
    follows &= (side < -_SMALL_OVERLAP) | (turn <= _MAX_ANGLE_BESIDE)
    row, other, step, gap = (values[follows] for values in (row, other, step, gap))
    order = np.lexsort((gap, step, row))
    row, other, step, gap = (values[order] for values in (row, other, step, gap))
    first = np.ones(len(row), bool)
    first[1:] = (np.diff(row) != 0) | (np.diff(step) != 0)
    row, other, step, gap = (values[first] for values in (row, other, step, gap))
    closing = own_speeds[row, step] - speeds[other, step]
    meets = closing > 0  # False where the speed of the other one is not known
    times = np.divide(gap, closing, out=np.full(len(gap), MAX_TIME_TO_COLLISION), where=meets)
    result[row, step] = np.minimum(times, MAX_TIME_TO_COLLISION)
    return result
