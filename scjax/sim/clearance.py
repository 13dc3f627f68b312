"""How lanes swerve around parked vehicles and obstacles; NumPy on the host."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from scjax.scene.angles import wrap_to_pi
from scjax.scene.boxes import corners
from scjax.sim.network_of_map import LanePoints

_HALF_WIDTH, _SIDE_GAP = 1.05, 0.35  # m of a passing car and beside it
MAX_SHIFT = 1.1  # m; what needs more blocks the lane
_REACH = 14.0  # m along the lane, over which a shift fades out
_PLATEAU = 4.0  # m around the obstacle with the full shift
_SAME_WAY = np.deg2rad(30.0)


def swerve(lanes: LanePoints, obstacles: Float64[np.ndarray, "obstacles 9"]) -> Float64[np.ndarray, "P 2"]:
    """x, y by which each point of the lanes moves aside, so that cars pass obstacles that stand beside the lane [m].

    Obstacles in the middle of a lane, which would need more than ``MAX_SHIFT``, and lanes with obstacles on both sides
    stay as they are: vehicles stop there.

    Args:
      obstacles: columns of ``Scene.agents`` in the frame of the lanes.
    """
    from scipy.spatial import KDTree

    normals = np.stack([-np.sin(lanes.headings), np.cos(lanes.headings)], -1)
    shift = np.zeros(len(lanes.points))
    tree = KDTree(lanes.points[:, :2])
    blocked = np.zeros(len(lanes.points), bool)
    for box, outline in zip(obstacles, corners(obstacles), strict=True):
        reach = np.hypot(box[6], box[7]) / 2 + _HALF_WIDTH + _SIDE_GAP + 1.0
        rows = np.array(tree.query_ball_point(box[:2], reach), int)
        if not len(rows):
            continue
        offset = outline[None] - lanes.points[rows, None, :2]
        ahead = (offset * normals[rows][:, None, ::-1] * [1, -1]).sum(-1)
        side = (offset * normals[rows][:, None]).sum(-1)
        beside = (ahead.min(1) < _PLATEAU) & (ahead.max(1) > -_PLATEAU)
        middle = side.mean(1)
        room = _HALF_WIDTH + _SIDE_GAP
        needed = np.where(middle > 0, np.minimum(side.min(1) - room, 0.0), np.maximum(side.max(1) + room, 0.0))
        rows, needed = rows[beside & (needed != 0)], needed[beside & (needed != 0)]
        blocked[rows] |= (np.abs(needed) > MAX_SHIFT) | (shift[rows] * needed < 0)
        shift[rows] = np.where(np.abs(needed) > np.abs(shift[rows]), needed, shift[rows])
    shift[blocked] = 0.0
    return _faded(lanes, shift, tree)[:, None] * normals


def _faded(lanes: LanePoints, shift: np.ndarray, tree) -> np.ndarray:
    """Shifts that fade out before and behind each shifted point, on following lanes too [P]."""
    out = shift.copy()
    for row in np.flatnonzero(shift):
        near = np.array(tree.query_ball_point(lanes.points[row, :2], _REACH), int)
        turn = wrap_to_pi(lanes.headings[near] - lanes.headings[row])
        offset = lanes.points[near, :2] - lanes.points[row, :2]
        heading = lanes.headings[row] + turn / 2
        side = -offset[:, 0] * np.sin(heading) + offset[:, 1] * np.cos(heading)
        near = near[(np.abs(turn) < _SAME_WAY) & (np.abs(side) < 0.5)]
        distance = np.hypot(*(lanes.points[near, :2] - lanes.points[row, :2]).T)
        share = 0.5 + 0.5 * np.cos(np.pi * np.clip(distance / _REACH, 0.0, 1.0))
        faded = shift[row] * share
        out[near] = np.where(np.abs(faded) > np.abs(out[near]), faded, out[near])
    return out
