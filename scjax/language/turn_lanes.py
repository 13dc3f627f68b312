"""Dedicated turn lanes: approaches of intersections that allow one turn only, next to a through lane."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from scjax.language.intersections import Intersection
from scjax.language.road import Road, wrap_to_pi

TurnDirection = Literal["left", "right"]
Movement = Literal["left", "straight", "right"]

_MIN_TURN = np.deg2rad(40.0)
_NEIGHBOR_DISTANCE = (2.0, 8.0)  # m to the side, between a turn lane and the through lane
_MAX_ALONG = 16.0  # m along the road, between the ends of the two lanes
_PARALLEL = 0.3  # rad
_OPPOSITE_DISTANCE = 1.0  # m to an opposite lane: the two are one center turn lane
_EGO_ANGLE = 0.5  # rad between the ego's approach and its heading
_EGO_LATERAL = 16.0  # m to the side of the ego
_EGO_BEHIND = -5.0  # m, approaches further behind are not the ego's


class TurnLane(NamedTuple):
    """A lane for one turn only.

    Attributes:
      turn: direction of the turn. lane: index of the lane.
      on_ego_approach: whether it belongs to the ego's approach. has_ego: whether the ego drives in it.
    """

    turn: TurnDirection
    lane: int
    on_ego_approach: bool
    has_ego: bool


class _Approach(NamedTuple):
    """A lane that leads into an intersection: where it enters [m], heading there [rad], movements that it allows."""

    lane: int
    position: np.ndarray
    heading: float
    movements: frozenset[Movement]


def find_turn_lanes(road: Road, intersections: list[Intersection], ego_lane: int | None) -> list[TurnLane]:
    """Dedicated turn lanes of all intersections."""
    turn_lanes = {}
    for intersection in intersections:
        approaches = _approaches(road, intersection)
        for approach in approaches:
            turn = _only_turn(approach)
            if turn is None or _is_center_turn_lane(road, approach):
                continue
            if any(_is_through_neighbor(approach, other, turn) for other in approaches):
                on_ego_approach = (
                    abs(wrap_to_pi(approach.heading)) < _EGO_ANGLE
                    and abs(approach.position[1]) < _EGO_LATERAL
                    and approach.position[0] > _EGO_BEHIND
                )
                lane = approach.lane
                turn_lanes[lane] = TurnLane(turn, lane, bool(on_ego_approach), lane == ego_lane)
    return list(turn_lanes.values())


def movement(turn: float, min_turn: float = _MIN_TURN) -> Movement:
    """Movement along a lane with signed turn ``turn`` [rad]; up to ``min_turn`` it is straight."""
    if abs(turn) <= min_turn:
        return "straight"
    return "left" if turn > 0 else "right"


def _only_turn(approach: _Approach) -> TurnDirection | None:
    if approach.movements == {"left"}:
        return "left"
    return "right" if approach.movements == {"right"} else None


def _approaches(road: Road, intersection: Intersection) -> list[_Approach]:
    """Lanes that lead into members, and members that start outside the disc (approach and turn in one lane)."""
    members, approaches = set(intersection.members), []
    for lane in range(len(road)):
        if lane in members:
            distance = np.linalg.norm(road.points[lane] - intersection.center, axis=-1)
            inside = np.flatnonzero(distance < intersection.radius)
            if not len(inside) or not inside[0]:
                continue
            entry = int(min(inside[0], road.headings.shape[1] - 2))
            turns: frozenset[Movement] = frozenset([movement(float(road.bends[lane, entry:].sum()))])
            position, heading = road.points[lane, entry], float(road.headings[lane, entry])
            approaches.append(_Approach(lane, position, heading, turns))
        else:
            turns = frozenset(movement(float(road.turn[k])) for k in road.successors[lane] if k in members)
            if turns:
                approaches.append(_Approach(lane, road.points[lane, -1], float(road.end_heading[lane]), turns))
    return approaches


def _is_through_neighbor(approach: _Approach, other: _Approach, turn: TurnDirection) -> bool:
    """Whether ``other`` goes straight on and runs on the inner side of the turn lane ``approach``."""
    if "straight" not in other.movements or abs(wrap_to_pi(other.heading - approach.heading)) > _PARALLEL:
        return False
    cos, sin = np.cos(approach.heading), np.sin(approach.heading)
    dx, dy = other.position - approach.position
    along, left = cos * dx + sin * dy, cos * dy - sin * dx
    side = -left if turn == "left" else left  # the through lane is to the right of a left-turn lane
    return bool(abs(along) < _MAX_ALONG and _NEIGHBOR_DISTANCE[0] <= side <= _NEIGHBOR_DISTANCE[1])


def _is_center_turn_lane(road: Road, approach: _Approach) -> bool:
    """Whether an opposite lane lies on the approach."""
    distances = np.linalg.norm(road.points - approach.position, axis=-1)
    point = distances.argmin(1)
    heading = road.headings[np.arange(len(road)), np.minimum(point, road.headings.shape[1] - 1)]
    is_opposite = np.abs(wrap_to_pi(heading - approach.heading)) > np.pi - _PARALLEL
    return bool((is_opposite & (distances.min(1) < _OPPOSITE_DISTANCE)).any())
