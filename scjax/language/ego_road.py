"""The road that the ego drives on: its lane and path, lanes beside it, curves, and the joints it comes to."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.language.intersections import Intersection
from scjax.language.road import Road, wrapped
from scjax.language.turn_lanes import Movement, movement

Joint = Literal["lane added", "lane ends", "split", "merge", "side road", "junction at the edge"]
Curve = Literal["straight", "gently left", "gently right", "left", "right", "winding"]

_ON_LANE = (2.5, np.deg2rad(45.0))  # metres and radians between the ego and its lane
_PATH = 40.0  # metres of the ego's path either way
_CUTS = (0.0, 6.0, -6.0, 12.0, -12.0, 18.0, -18.0, 24.0, -24.0)  # metres along the path where lanes are counted
_SAME = np.deg2rad(30.0)
_ONE = 1.8  # metres between lines that count as one lane
_TWO_WAY = 1.0  # metres between opposite lines of one centre turn lane
_GAP_SAME, _GAP_TURN = 6.0, 14.0  # metres to the next lane of the road, of the same and of the other direction
_MEDIAN = 6.0  # metres between the directions
_AT = 12.0  # metres from a joint at which its branches are compared
_ADDED = 0.3  # rad between branches that stay beside each other
_SIDE = 1.0  # rad of a branch into a side road
_OPTION = np.deg2rad(35.0)  # least turn of a way that the ego may choose
_EDGE = 18.0  # metres from the ego at which joints are at the edge of view


@dataclasses.dataclass(frozen=True)
class CrossSection:
    """Lanes of the ego's road: its direction (the ego's lane included) and the other.

    ``index`` counts the ego's lane from the left, 1 first; ``centre_turn`` is a lane that both directions may use.
    """

    same: int
    opposite: int
    index: int
    centre_turn: bool
    median: bool


def ego_lane(road: Road) -> int | None:
    """The lane that the ego, at the origin facing +x, drives in; None where it is on none."""
    if not len(road):
        return None
    distance = np.linalg.norm(road.line, axis=-1)
    point = distance.argmin(1)
    lane = np.arange(len(road))
    heading = road.chord[lane, np.minimum(point, road.chord.shape[1] - 1)]
    off = np.abs(wrapped(heading))
    # The turn of the whole lane picks the one that goes straight on where branches overlap.
    cost = distance[lane, point] + 2 * off + 0.4 * np.abs(road.bend).sum(1)
    cost[(distance[lane, point] > _ON_LANE[0]) | (off > _ON_LANE[1])] = np.inf
    return int(cost.argmin()) if np.isfinite(cost.min()) else None


def ego_path(road: Road, lane: int) -> np.ndarray:
    """The ego's lane drawn on by its straightest neighbours: points every metre from -40 to +40 m at most, [n, 2]."""
    line = road.line[lane]
    for ahead in (True, False):
        at, used = lane, {lane}
        while np.linalg.norm(np.diff(line, axis=0), axis=-1).sum() < 4 * _PATH:
            choices = [n for n in (road.successors if ahead else road.predecessors)[at] if n not in used]
            if not choices:
                break
            at = min(choices, key=lambda n: abs(road.turn[n]))
            used.add(at)
            line = np.concatenate([line, road.line[at]] if ahead else [road.line[at], line])
    step = np.linalg.norm(np.diff(line, axis=0), axis=-1)
    line = line[np.concatenate([[True], step > 1e-6])]  # joints are there twice, and have no heading
    arc = np.concatenate([[0], np.cumsum(step[step > 1e-6])])
    here = arc[np.linalg.norm(line, axis=-1).argmin()]
    at = np.arange(max(-_PATH, np.ceil(arc[0] - here)), min(_PATH, arc[-1] - here) + 0.5)
    return np.stack([np.interp(at + here, arc, line[:, k]) for k in (0, 1)], -1)


def cross_section(road: Road, path: np.ndarray, intersections: list[Intersection]) -> CrossSection:
    """Lanes per direction: the median of the first three cuts across the path that lie in no intersection."""
    here = int(np.linalg.norm(path, axis=-1).argmin())
    found = []
    for at in _CUTS:
        point = here + round(at)
        if not 0 < point < len(path) - 1 or any(
            np.linalg.norm(path[point] - item.centre) < item.radius for item in intersections
        ):
            continue
        found.append(_cut(road, path[point], path[point + 1] - path[point - 1]))
        if len(found) == 3:
            break
    if not found:
        found = [_cut(road, path[here], path[min(here + 1, len(path) - 1)] - path[max(here - 1, 0)])]
    middle = sorted(found, key=lambda cut: (cut.same, cut.opposite))[len(found) // 2]
    opposite = int(np.median([cut.opposite for cut in found]))
    return dataclasses.replace(middle, opposite=opposite)


def curve(path: np.ndarray, intersections: list[Intersection]) -> Curve:
    """Shape of the path within 30 m and up to the next intersection: its net turn, or winding where it turns back."""
    here = int(np.linalg.norm(path, axis=-1).argmin())
    low, high = max(here - 30, 0), min(here + 31, len(path))
    for item in intersections:
        inside = np.flatnonzero(np.linalg.norm(path - item.centre, axis=-1) < item.radius)
        high = min([high, *inside[inside >= here]])
        low = max([low, *(inside[inside < here] + 1)])
    part = path[low:high]
    if len(part) < 12:
        return "straight"
    step = part[3:] - part[:-3]
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    net = np.rad2deg(heading[-1] - heading[0])
    if abs(net) <= 15 and np.ptp(heading) > 0.35:
        return "winding"
    if abs(net) > 20:
        return "left" if net > 0 else "right"
    if abs(net) > 8:
        return "gently left" if net > 0 else "gently right"
    return "straight"


def joints(
    road: Road, lane: int, intersections: list[Intersection]
) -> list[tuple[Joint, np.ndarray, Literal["left", "right"]]]:
    """Forks and merges of the ego's road outside intersections: what they are, where, and on which side."""
    mine = road.connected(lane)
    found = []
    for at in range(len(road)):
        for fork, branches in ((True, road.successors[at]), (False, road.predecessors[at])):
            if len(branches) < 2:
                continue
            place = road.line[at, -1 if fork else 0]
            if any(np.linalg.norm(place - item.centre) < item.radius + 6 for item in intersections):
                continue
            if at in mine or abs(place[1]) < 15:
                found.append(_joint(road, branches, fork, place))
    return found


def ego_options(road: Road, lane: int, most: float = 60.0) -> set[Movement]:
    """Where the ego may go at the next fork ahead; empty if none is in view."""
    way, at, used = -road.length[lane] / 2, lane, {lane}
    while way < most:
        after = [n for n in road.successors[at] if n not in used]
        if len(after) > 1:
            return {movement(float(road.turn[n]), _OPTION) for n in after}
        if not after:
            return set()
        at = after[0]
        used.add(at)
        way += road.length[at]
    return set()


def _joint(road: Road, branches: list[int], fork: bool, place: np.ndarray):
    """Compares the outermost branches some metres from the joint."""
    angles = []
    for branch in branches:
        count = road.line.shape[1]
        near = min(count - 1, max(1, round(_AT / max(road.length[branch], 1e-6) * (count - 1))))
        end = road.line[branch, near] if fork else road.line[branch, count - 1 - near]
        away = end - road.line[branch, 0] if fork else road.line[branch, -1] - end
        angles.append(float(np.arctan2(away[1], away[0])))
    main = min(range(len(branches)), key=lambda k: abs(road.turn[branches[k]]))
    other = max(range(len(branches)), key=lambda k: abs(wrapped(angles[k] - angles[main])))
    angle = wrapped(angles[other] - angles[main])
    side = "left" if (angle > 0) == fork else "right"
    if abs(road.turn[branches[other]]) > _SIDE:
        kind = "side road"
    elif np.linalg.norm(place) > _EDGE and (abs(angle) >= _ADDED or road.length[branches].min() < _AT / 2):
        kind = "junction at the edge"
    elif abs(angle) < _ADDED:
        kind = "lane added" if fork else "lane ends"
    else:
        kind = "split" if fork else "merge"
    return kind, place, side


def _cut(road: Road, place: np.ndarray, along: np.ndarray) -> CrossSection:
    """Lanes met by a perpendicular through ``place``, walking outwards until the road ends."""
    ahead = along / np.linalg.norm(along)
    left = np.array([-ahead[1], ahead[0]])
    offset = (road.line - place) @ np.stack([ahead, left], -1)
    crosses = offset[:, :-1, 0] * offset[:, 1:, 0] <= 0
    lane, segment = np.nonzero(crosses & (np.abs(offset[:, 1:, 0] - offset[:, :-1, 0]) > 1e-9))
    first, last = offset[lane, segment], offset[lane, segment + 1]
    lateral = first[:, 1] + (last[:, 1] - first[:, 1]) * first[:, 0] / (first[:, 0] - last[:, 0])
    turn = np.abs(wrapped(road.chord[lane, segment] - np.arctan2(ahead[1], ahead[0])))
    same = _merged(lateral[turn < _SAME])
    opposite = _merged(lateral[turn > np.pi - _SAME])
    # A centre turn lane is drawn once in each direction.
    shared = [x for x in same if any(abs(x - y) < _TWO_WAY for y in opposite) and abs(x) > _ONE / 2]
    same = [x for x in same if x not in shared]
    opposite = [y for y in opposite if all(abs(x - y) >= _TWO_WAY for x in shared)]
    marks = sorted([(x, "same") for x in same] + [(y, "opposite") for y in opposite] + [(x, "turn") for x in shared])
    if not same:
        return CrossSection(1, 0, 1, bool(shared), False)
    start = min((k for k, (_, kind) in enumerate(marks) if kind == "same"), key=lambda k: abs(marks[k][0]))
    kept, median = [start], False
    for step in (1, -1):
        k = start
        while 0 <= k + step < len(marks):
            gap = abs(marks[k + step][0] - marks[k][0])
            changes = marks[k + step][1] != marks[k][1]
            if gap > (_GAP_TURN if changes else _GAP_SAME):
                break
            median |= changes and gap > _MEDIAN
            k += step
            kept.append(k)
    kinds = [marks[k][1] for k in kept]
    further_left = sum(marks[k][1] == "same" and marks[k][0] > marks[start][0] for k in kept)
    return CrossSection(kinds.count("same"), kinds.count("opposite"), 1 + further_left, "turn" in kinds, median)


def _merged(lateral: np.ndarray) -> list[float]:
    """Lines closer than 1.8 m are one lane."""
    found: list[float] = []
    for value in sorted(lateral.tolist(), key=abs):
        if all(abs(value - other) >= _ONE for other in found):
            found.append(value)
    return found
