"""Signals of a new tile that agree with those of the map: of lanes that go on across the seam, and of one junction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64, Int

from scjax.outpainting.lane_merges import NO_ROW, NewLanes
from scjax.scene import MapLane, Signal
from scjax.scene.angles import wrap_to_pi
from scjax.scene.polyline import point_headings, spread_points

_ACROSS = np.deg2rad(30.0)  # between lanes that cross
_ONE_APPROACH, _SAME_WAY = 12.0, np.deg2rad(30.0)  # m and rad between the starts of lanes of one approach
_CROSSING = 1.0  # m between lanes that cross
_ONE_PLACE, _STRAIGHT = 5.0, np.deg2rad(20.0)  # m between the starts of lanes straight on that have one light
_GOES = (Signal.GO, Signal.CAUTION)


def tile_signals(
    sampled: Int[np.ndarray, " rows"], lanes: NewLanes, known: Mapping[str, MapLane], states: Mapping[str, int]
) -> Int[np.ndarray, " lanes"]:
    """The ``Signal`` of each new lane.

    A lane that continues a lane of the map has the signal of that one, if it alone does; it has none of its own. Where
    the lanes of an approach cross a lane with a signal of the map on which traffic goes, they stop. Lanes straight on
    from one place have one light: that of the map's lanes, else red if one of them is.

    Args:
      sampled: signals of the lanes of the sample.
      known: lanes of the map near the tile, by their ids.
      states: ``Signal`` of those lanes of the map that have one.
    """
    signals = np.array([Signal.UNKNOWN if row == NO_ROW else sampled[row] for row in lanes.rows], np.int32)
    for index, row in enumerate(lanes.rows):
        if row != NO_ROW and row in lanes.rows[:index]:
            signals[index] = Signal.UNKNOWN  # the rest of a lane that was cut
    fixed = _inherit(signals, lanes, states)
    going = [known[name].points for name, state in states.items() if state in _GOES and name in known]
    going += [lanes.lines[lane] for lane in fixed if signals[lane] in _GOES]
    free = [lane for lane in np.flatnonzero(signals != Signal.UNKNOWN).tolist() if lane not in fixed]
    for lane in free:
        if signals[lane] in _GOES and any(_cross(lanes.lines[lane], other) for other in going):
            for other in free:
                if _is_one_approach(lanes.lines[lane], lanes.lines[other]):
                    signals[other] = Signal.STOP
    for lane in free:
        beside = [other for other in (*fixed, *free) if _have_one_light(lanes.lines[lane], lanes.lines[other])]
        shown = {int(signals[other]) for other in beside if other in fixed and signals[other] != Signal.UNKNOWN}
        if len(shown) == 1:
            signals[lane] = shown.pop()
        elif any(signals[other] == Signal.STOP for other in beside):
            signals[lane] = Signal.STOP
    return signals


def _inherit(signals: Int[np.ndarray, " lanes"], lanes: NewLanes, states: Mapping[str, int]) -> set[int]:
    """Sets the signals of lanes that continue lanes of the map which have one; which lanes these are."""
    fixed = set()
    for joint in lanes.joints:
        state = states.get(joint.open_end.lane_id)
        if state is None or (not joint.at_start and signals[joint.lane] == Signal.UNKNOWN):
            continue
        alike = [
            other
            for other in lanes.joints
            if other.at_start == joint.at_start
            and (other.lane == joint.lane or other.open_end.lane_id == joint.open_end.lane_id)
        ]
        signals[joint.lane] = state if len(alike) == 1 or not joint.at_start else Signal.UNKNOWN
        fixed.add(joint.lane)
    return fixed


def _cross(one: Float64[np.ndarray, "_ 3"], other: Float64[np.ndarray, "_ 3"]) -> bool:
    """Whether two lanes cross or come from two sides into one."""
    points, others = spread_points(one[:, :2]), spread_points(other[:, :2])
    if len(points) < 2 or len(others) < 2:
        return False
    near = np.hypot(*np.moveaxis(points[:, None] - others[None], -1, 0)) < _CROSSING
    turn = np.abs(wrap_to_pi(point_headings(points)[:, None] - point_headings(others)[None]))
    return bool((near & (turn > _ACROSS) & (turn < np.pi - _ACROSS)).any())


def _is_one_approach(one: Float64[np.ndarray, "_ 3"], other: Float64[np.ndarray, "_ 3"]) -> bool:
    turn = wrap_to_pi(_start_heading(one) - _start_heading(other))
    return bool(np.hypot(*(one[0] - other[0])[:2]) < _ONE_APPROACH and abs(turn) < _SAME_WAY)


def _have_one_light(one: Float64[np.ndarray, "_ 3"], other: Float64[np.ndarray, "_ 3"]) -> bool:
    """Whether two lanes lead straight on from one place, a lane itself included."""
    if np.hypot(*(one[0] - other[0])[:2]) > _ONE_PLACE:
        return False
    start, end, other_start, other_end = (
        heading for line in (one, other) for heading in (_start_heading(line), _start_heading(line[::-1]) + np.pi)
    )
    turns = np.array([end - start, other_end - other_start, start - other_start])
    return bool((np.abs(wrap_to_pi(turns)) < _STRAIGHT).all())


def _start_heading(line: Float64[np.ndarray, "_ 3"]) -> float:
    return float(np.arctan2(*(line[1] - line[0])[:2][::-1]))
