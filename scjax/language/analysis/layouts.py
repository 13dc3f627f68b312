"""What the road is: the first word for it, and all words that fit."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from scjax.language.analysis.crossroads import Crossroad
from scjax.language.analysis.ego_route import EgoRoute
from scjax.language.analysis.lane_lines import LaneLines
from scjax.language.analysis.partings import Parting
from scjax.scene.angles import wrap_to_pi

REACH = 32.0  # m ahead of the ego and to its sides, within which a junction names the road
_NAMED = 24.0  # m around the ego, within which junctions beside the nearest one give it their names, too
_CURVE_TURN, _WINDING_TURN = np.deg2rad(12.0), np.deg2rad(13.0)
_DEAD_END_BORDER = 5.0  # m inside the window, where lanes end for good
_DEAD_END_REACH = 10.0  # m around the end of a dead end, without a lane that goes on
_MIN_ROW = 5  # vehicles that stand across an aisle, in a parking lot
_ROW_DISTANCE = (2.5, 8.0)  # m from the middle of an aisle
_ROW_ANGLE = np.deg2rad((40.0, 140.0))  # between a parked vehicle and the aisle
_STANDING = 0.5  # m/s


def route_turns(headings: Float64[np.ndarray, " points"]) -> tuple[float, float, float]:
    """Net turn along a way, and its largest turns to the left and to the right [rad], the latter two >= 0."""
    if len(headings) < 2:
        return 0.0, 0.0, 0.0
    heading = np.concatenate([[0.0], np.cumsum(wrap_to_pi(np.diff(headings)))])
    left = float((heading - np.minimum.accumulate(heading)).max())
    right = float((np.maximum.accumulate(heading) - heading).max())
    return float(heading[-1]), left, right


def road_shape(route: EgoRoute | None) -> str:
    """ "straight", "curve" or "winding", by the ego's way within 32 m."""
    if route is None:
        return "straight"
    net, left, right = route_turns(route.points[np.abs(route.along) <= REACH, 3])
    if left > _WINDING_TURN and right > _WINDING_TURN:
        return "winding"
    return "curve" if abs(net) > _CURVE_TURN else "straight"


def has_dead_end(lines: LaneLines, window: tuple[float, float, float, float]) -> bool:
    """Whether a lane ends inside the window where no other lane of its road goes on."""
    last = lines.points[np.arange(len(lines)), lines.count - 1]
    low, high = np.array(window[::2]) + _DEAD_END_BORDER, np.array(window[1::2]) - _DEAD_END_BORDER
    inside = ((last[:, :2] > low) & (last[:, :2] < high)).all(1)
    for lane in np.flatnonzero(inside & ~lines.follows.any(1) & (lines.length > 8.0)):
        heading = float(lines.headings[lane, -1])
        offset = lines.points[..., :2] - last[lane, :2]
        forward = np.cos(heading) * offset[..., 0] + np.sin(heading) * offset[..., 1]
        near = (np.hypot(offset[..., 0], offset[..., 1]) < _DEAD_END_REACH) & lines.real
        if not (near & (forward > 3.0)).any():
            return True
    return False


def has_parking_rows(distance: np.ndarray, angle: np.ndarray, speed: np.ndarray) -> bool:
    """Whether vehicles stand in rows across aisles.

    Args:
      distance, angle: of every vehicle to every lane [vehicles, lanes] [m, rad].
      speed: [vehicles] [m/s].
    """
    if not distance.size:
        return False
    lane = distance.argmin(1)
    rows = np.arange(len(lane))
    off, across = distance[rows, lane], angle[rows, lane]
    stands = (speed < _STANDING) & (off > _ROW_DISTANCE[0]) & (off < _ROW_DISTANCE[1])
    return int((stands & (across > _ROW_ANGLE[0]) & (across < _ROW_ANGLE[1])).sum()) >= _MIN_ROW


def layout_names(
    crossroads: list[Crossroad],
    partings: list[Parting],
    shape: str,
    *,
    has_ring: bool,
    has_parking: bool,
    has_overpass: bool,
    is_dead_end: bool,
) -> tuple[str, ...]:
    """All layouts that fit a scene, the first word for it in front."""
    near = [item for item in crossroads if np.abs(item.center).max() <= REACH]
    names: list[str] = []
    if has_ring:
        names.append("roundabout")
    if has_parking:
        names.append("parking-lot")
    for item in [item for k, item in enumerate(near) if not k or np.hypot(*item.center) < _NAMED]:
        names += [kind for kind in item.kinds if kind != "complex"]
    if len(near) > 1:
        names.append("multi-intersection")
    splits = [item for item in partings if item.is_split and not _beside(item, near)]
    names += ["split"] * any(item.is_fork for item in splits) + ["merge"] * any(not item.is_fork for item in splits)
    if is_dead_end:
        names.append("dead-end")
    if not near and not has_ring:
        names += [shape, "no-intersection"]
    else:
        names.append("intersection")
    if has_overpass:
        names.append("crossing-overpass")
    return tuple(dict.fromkeys(names))


def _beside(parting: Parting, crossroads: list[Crossroad]) -> bool:
    return any(np.hypot(*(parting.place[:2] - item.center)) < item.radius + 8.0 for item in crossroads)
