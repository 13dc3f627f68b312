"""New lanes on which a lane that would end dead goes on: into the lane beside it, or the last meters to the border."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.outpainting.bends import Joint, is_met, line_to
from scjax.outpainting.coverage import OpenEnd
from scjax.outpainting.measures import kinks_of
from scjax.scene.angles import wrap_to_pi
from scjax.scene.polyline import cumulative_length, spread_points

NO_ROW = -1
"""Row of lanes that no sample shows."""

_BESIDE = 4.5  # m between a lane and the one that it merges into
_NEAREST, _PER_SIDE, _BEST, _FARTHEST = 5.0, 3.5, 15.0, 28.0  # m ahead where lanes merge; at least per m aside
_TURN = np.deg2rad(30.0)  # between the lanes
_LOOSE = 5.0  # m of cost by which an end without a neighbor is better than another place
_PIECE = 3.0  # m of a lane before and behind the place where another one merges
_STEP = 0.5  # m between points of a merging lane
_TO_BORDER = 5.0  # m by which a lane goes straight on to the border of the covered ground


@dataclasses.dataclass
class NewLanes:
    """New lanes of a tile.

    Attributes:
      lines: their points in the frame of the map [m].
      rows: of the sample, or ``NO_ROW``.
      edges: pairs of lines, the second of which follows the first.
      joints: ends that continue lanes of the map.
    """

    lines: list[Float64[np.ndarray, "_ 3"]]
    rows: list[int]
    edges: list[tuple[int, int]]
    joints: list[Joint]


class DeadEnd(NamedTuple):
    """An end of a lane of the map, or of the new lane of an index, that nothing continues on covered ground."""

    end: OpenEnd
    lane: int | None = None


def reach_border(
    lanes: NewLanes, dead: Sequence[DeadEnd], is_dead: Callable[[np.ndarray, float], bool]
) -> list[DeadEnd]:
    """Lets lanes go straight on from dead ends to the border of the covered ground, where it is less than 5 m ahead.

    Args:
      is_dead: whether an end at a place x, y [m] and with this direction out of the lane [rad] would be dead.

    Returns:
      The ends that are still dead.
    """
    left = []
    for one in dead:
        way = np.array([np.cos(one.end.outward), np.sin(one.end.outward), 0.0])
        steps = [step * way for step in np.arange(_STEP, _TO_BORDER, _STEP).tolist()]
        step = next((step for step in steps if not is_dead((one.end.place + step)[:2], one.end.outward)), None)
        if step is None:
            left.append(one)
        elif one.lane is None:
            line = np.stack([one.end.place, one.end.place + step])
            _attach(lanes, one, line[::-1] if one.end.is_start else line)
        else:
            line, place = lanes.lines[one.lane], (one.end.place + step)[None]
            lanes.lines[one.lane] = np.concatenate([place, line] if one.end.is_start else [line, place])
    return left


def merge_beside(lanes: NewLanes, dead: Sequence[DeadEnd]) -> list[DeadEnd]:
    """Adds lanes that lead from dead ends into new lanes beside them, which are cut in two there.

    A lane's dead start gets one that leaves the lane beside. The lanes of the map stay as they are.

    Returns:
      The ends that are still dead.
    """
    left = []
    for one in dead:
        choices = [choice for row in range(len(lanes.lines)) if row != one.lane and (choice := _place(lanes, row, one))]
        if not choices:
            left.append(one)
            continue
        _, row, place, line = min(choices, key=lambda choice: choice[0])
        before, after = _cut(lanes, row, place)
        met = lanes.lines[before][-1] if one.end.is_start else lanes.lines[after][0]
        line = line_to(line, met, at_start=one.end.is_start)
        added = _attach(lanes, one, line)
        lanes.edges.append((before, added) if one.end.is_start else (added, after))
    return left


def _attach(lanes: NewLanes, dead: DeadEnd, line: Float64[np.ndarray, "_ 3"]) -> int:
    """Adds a line at a dead end; its index."""
    added = len(lanes.lines)
    lanes.lines.append(line)
    lanes.rows.append(NO_ROW)
    if dead.lane is None:
        lanes.joints.append(Joint(added, not dead.end.is_start, dead.end))
    else:
        lanes.edges.append((added, dead.lane) if dead.end.is_start else (dead.lane, added))
    return added


def _place(lanes: NewLanes, row: int, dead: DeadEnd) -> tuple[float, int, float, np.ndarray] | None:
    """Where a dead end can lead into a lane: cost, the lane, the place along it [m] and the line to there."""
    end, line = dead.end, lanes.lines[row]
    way = np.array([np.cos(end.outward), np.sin(end.outward)])
    points = spread_points(line, _STEP)
    if len(points) < 3:
        return None
    sign = -1.0 if end.is_start else 1.0
    directions = sign * np.gradient(points[:, :2], axis=0)
    turn = np.abs(wrap_to_pi(np.arctan2(directions[:, 1], directions[:, 0]) - end.outward))
    offset = points[:, :2] - end.place[:2]
    ahead, aside = offset @ way, np.abs(way[0] * offset[:, 1] - way[1] * offset[:, 0])
    arc = cumulative_length(points)
    inside = (arc >= _PIECE) & (arc <= arc[-1] - _PIECE)
    far = -1 if end.is_start else 0
    loose = {a for a, _ in lanes.edges} if end.is_start else {b for _, b in lanes.edges}
    loose |= {joint.lane for joint in lanes.joints if joint.at_start != end.is_start}
    inside[far] = row not in loose
    possible = inside & (ahead >= np.maximum(_NEAREST, _PER_SIDE * aside)) & (ahead <= _FARTHEST)
    possible &= (aside <= _BESIDE) & (turn <= _TURN)
    cost = np.where(possible, aside + 0.1 * np.abs(ahead - _BEST), np.inf)
    cost[far] -= _LOOSE
    best = int(cost.argmin())
    if not possible[best]:
        return None
    curve = _curve(end, points[best], directions[best] / max(float(np.hypot(*directions[best])), 1e-9))
    smooth = is_met(curve, Joint(row, not end.is_start, end)) and not len(kinks_of(curve))
    return (float(cost[best]), row, float(arc[best]), curve) if smooth else None


def _curve(end: OpenEnd, place: np.ndarray, direction: np.ndarray) -> Float64[np.ndarray, "n 3"]:
    """The cubic from an end to a place and direction, in driving direction."""
    distance = float(np.hypot(*(place - end.place)[:2]))
    u = np.linspace(0.0, 1.0, max(round(distance / _STEP), 2) + 1)[:, None]
    out = np.array([np.cos(end.outward), np.sin(end.outward), 0.0]) * distance
    into = np.array([*direction, 0.0]) * distance
    start, stop = np.where(np.isnan(end.place), place, end.place), place
    curve = (2 * u**3 - 3 * u**2 + 1) * start + (u**3 - 2 * u**2 + u) * out
    curve = curve + (3 * u**2 - 2 * u**3) * stop + (u**3 - u**2) * into
    curve[[0, -1]] = end.place, place
    return curve[::-1] if end.is_start else curve


def _cut(lanes: NewLanes, row: int, place: float) -> tuple[int, int]:
    """Cuts a lane at a place along it, or not at its ends; the lanes before and after that place."""
    line = lanes.lines[row]
    arc = cumulative_length(line)
    if place <= 0 or place >= arc[-1]:
        return row, row
    at = np.array([[np.interp(place, arc, column) for column in line.T]])
    lanes.lines[row] = np.concatenate([line[arc < place - 1e-6], at])
    after = len(lanes.lines)
    lanes.lines.append(np.concatenate([at, line[arc > place + 1e-6]]))
    lanes.rows.append(lanes.rows[row])
    lanes.edges[:] = [(after if a == row else a, b) for a, b in lanes.edges] + [(row, after)]
    lanes.joints[:] = [
        joint._replace(lane=after) if joint.lane == row and not joint.at_start else joint for joint in lanes.joints
    ]
    return row, after
