"""Approaches of intersections that allow one turn only, beside an approach that goes straight on."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from scjax.language.intersections import Intersection
from scjax.language.road import Road, wrapped

Turn = Literal["left", "right"]
Movement = Literal["left", "straight", "right"]

_TURN = np.deg2rad(40.0)
_BESIDE = (2.0, 8.0)  # metres between a turn lane and its neighbour that goes straight on
_LEVEL = 16.0  # metres by which their ends may be apart along the road
_PARALLEL = 0.3  # rad
_TWIN = 1.0  # metres to an opposite lane: a centre turn lane, which is no approach
_OF_EGO = (0.5, 16.0)  # rad off the ego's heading, metres to its side


class TurnLane(NamedTuple):
    """A lane that may only turn; ``ego``: it belongs to the ego's approach, ``holds_ego``: the ego drives in it."""

    turn: Turn
    lane: int
    ego: bool
    holds_ego: bool


class _Approach(NamedTuple):
    lane: int
    place: np.ndarray
    heading: float
    movements: frozenset[Movement]


def find_turn_lanes(road: Road, intersections: list[Intersection], ego: int | None) -> list[TurnLane]:
    """Dedicated turn lanes of all intersections."""
    found = {}
    for item in intersections:
        approaches = _approaches(road, item)
        for approach in approaches:
            turn: Turn | None = None
            if approach.movements == {"left"}:
                turn = "left"
            elif approach.movements == {"right"}:
                turn = "right"
            if turn is None or _has_twin(road, approach):
                continue
            if any(_beside(approach, other, turn) for other in approaches):
                of_ego = (
                    abs(wrapped(approach.heading)) < _OF_EGO[0]
                    and abs(approach.place[1]) < _OF_EGO[1]
                    and approach.place[0] > -5
                )
                found[approach.lane] = TurnLane(turn, approach.lane, bool(of_ego), approach.lane == ego)
    return list(found.values())


def movement(turn: float, least: float = _TURN) -> Movement:
    """left, straight or right, by the signed turn of a lane [rad]; less than ``least`` is straight."""
    if abs(turn) <= least:
        return "straight"
    return "left" if turn > 0 else "right"


def _approaches(road: Road, item: Intersection) -> list[_Approach]:
    """Lanes that lead into members, and members that begin outside the disc (approach and turn as one lane)."""
    members, found = set(item.members), []
    for lane in range(len(road)):
        if lane in members:
            inside = np.flatnonzero(np.linalg.norm(road.line[lane] - item.centre, axis=-1) < item.radius)
            if not len(inside) or not inside[0]:
                continue
            enter = int(min(inside[0], road.chord.shape[1] - 2))
            moves: frozenset[Movement] = frozenset([movement(float(road.bend[lane, enter:].sum()))])
            found.append(_Approach(lane, road.line[lane, enter], float(road.chord[lane, enter]), moves))
        else:
            moves = frozenset(movement(float(road.turn[after])) for after in road.successors[lane] if after in members)
            if moves:
                found.append(_Approach(lane, road.line[lane, -1], float(road.end_heading[lane]), moves))
    return found


def _beside(approach: _Approach, other: _Approach, turn: str) -> bool:
    if "straight" not in other.movements or abs(wrapped(other.heading - approach.heading)) > _PARALLEL:
        return False
    cos, sin = np.cos(approach.heading), np.sin(approach.heading)
    dx, dy = other.place - approach.place
    along, left = cos * dx + sin * dy, cos * dy - sin * dx
    side = -left if turn == "left" else left  # the lane that goes on lies to the right of a left-turn lane
    return bool(abs(along) < _LEVEL and _BESIDE[0] <= side <= _BESIDE[1])


def _has_twin(road: Road, approach: _Approach) -> bool:
    near = np.linalg.norm(road.line - approach.place, axis=-1)
    point = near.argmin(1)
    heading = road.chord[np.arange(len(road)), np.minimum(point, road.chord.shape[1] - 1)]
    opposite = np.abs(wrapped(heading - approach.heading)) > np.pi - _PARALLEL
    return bool((opposite & (near.min(1) < _TWIN)).any())
