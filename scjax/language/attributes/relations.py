"""Vehicles relative to the ego's way."""

from __future__ import annotations

import numpy as np

from scjax.language.analysis.platoons import leader_gaps, longest_platoon
from scjax.language.analysis.scene_analysis import Analysis
from scjax.language.attributes.base import Attribute, count_of
from scjax.scene.angles import wrap_to_pi

_REACH = 32.0  # m along the way
_OWN_LATERAL = 1.8  # m
_ALONG = np.deg2rad(45.0)
_ONCOMING_ANGLE, _CROSSING_ANGLE = np.deg2rad(150.0), np.deg2rad((60.0, 120.0))
_LANE_MARGIN = 1.8  # m around the middle of a lane
_NEIGHBOR = (1.8, 5.4)  # m to the side
_LEVEL = 3.0  # m of height between vehicles on one level
_MOVING = 0.5  # m/s
_QUEUE_SPEED, _QUEUE_GAP, _QUEUE_SIZE = 2.0, 10.0, 3  # m/s, m, vehicles


def _in_lane(scene: Analysis, sign: int) -> np.ndarray:
    """Vehicles on the ego's way, ahead (1) or behind (-1); not those that head across it, nor parked ones."""
    positions = scene.positions
    if positions is None:
        return np.zeros(len(scene.types), bool)
    along = sign * positions.along
    rows = scene.vehicles & (np.abs(positions.lateral) < _OWN_LATERAL) & positions.beside & ~scene.parked_vehicles
    rows &= (positions.angle < _CROSSING_ANGLE[0]) | (positions.angle > _CROSSING_ANGLE[1])
    return rows & (along > 0) & (along <= _REACH)


def _gap_ahead(scene: Analysis) -> float | None:
    rows = _in_lane(scene, 1)
    if scene.positions is None or not rows.any():
        return None
    gaps = scene.positions.along[rows] - (scene.agents[rows, 6] + scene.ego[6]) / 2
    return max(0.0, float(gaps.min()))


def _beside(scene: Analysis, sign: int) -> int:
    """Vehicles in the next lane of the same direction, to the left (1) or right (-1)."""
    positions = scene.positions
    if positions is None:
        return 0
    lateral = sign * positions.lateral
    rows = scene.vehicles & (lateral > _NEIGHBOR[0]) & (lateral < _NEIGHBOR[1]) & (positions.angle < _ALONG)
    return count_of(rows & (np.abs(positions.along) <= _REACH) & positions.beside & (scene.relations.lane >= 0))


def _oncoming(scene: Analysis) -> int:
    positions, section = scene.positions, scene.section
    if positions is None or section is None or not section.opposite:
        return 0
    low, high = min(section.opposite) - _LANE_MARGIN, max(section.opposite) + _LANE_MARGIN
    rows = scene.vehicles & (positions.angle > _ONCOMING_ANGLE) & positions.beside & ~scene.parked_vehicles
    return count_of(rows & (positions.lateral > low) & (positions.lateral < high))


def _crossing(scene: Analysis) -> int:
    turn = np.abs(wrap_to_pi(scene.yaw - np.arctan2(scene.ego[5], scene.ego[4])))
    across = (turn > _CROSSING_ANGLE[0]) & (turn < _CROSSING_ANGLE[1])
    across &= np.abs(scene.agents[:, 2] - scene.ego[2]) < _LEVEL
    if scene.positions is not None:
        across &= scene.positions.angle > _ALONG  # those that follow a bend of the ego's own road do not cross it
    return count_of(
        scene.vehicles & ~scene.parked_vehicles & across & ((scene.speeds > _MOVING) | (scene.relations.lane >= 0))
    )


def _has_queue(scene: Analysis) -> bool:
    rows = np.flatnonzero(scene.vehicles & ~scene.parked_vehicles & (scene.speeds < _QUEUE_SPEED))
    rows = rows[scene.relations.lane[rows] >= 0]
    if len(rows) < _QUEUE_SIZE:
        return False
    leader, gap = leader_gaps(scene.lines, scene.relations, scene.agents, rows)
    return longest_platoon(leader, gap, _QUEUE_GAP) >= _QUEUE_SIZE


RELATIONS = (
    Attribute(
        "ahead",
        "range",
        "Vehicles on the ego's way, within 1.8 m of it and 32 m ahead; none that cross it or are parked.",
        lambda scene: count_of(_in_lane(scene, 1)),
    ),
    Attribute(
        "behind",
        "range",
        "Vehicles on the ego's way, within 1.8 m of it and 32 m behind; none that cross it or are parked.",
        lambda scene: count_of(_in_lane(scene, -1)),
    ),
    Attribute(
        "gap_ahead",
        "range",
        "Distance from the ego's front to the next vehicle on its way; without one, only an open end holds.",
        _gap_ahead,
        unit="m",
        open_without=True,
    ),
    Attribute(
        "left_lane",
        "range",
        "Vehicles in the next lane of the ego's direction to its left.",
        lambda scene: _beside(scene, 1),
    ),
    Attribute(
        "right_lane",
        "range",
        "Vehicles in the next lane of the ego's direction to its right.",
        lambda scene: _beside(scene, -1),
    ),
    Attribute(
        "oncoming",
        "range",
        "Vehicles on the ego's road that head against it, by 150 degrees or more.",
        _oncoming,
    ),
    Attribute(
        "crossing",
        "range",
        "Vehicles that head across the ego, by 60 to 120 degrees, and move or are on a lane.",
        _crossing,
    ),
    Attribute(
        "queue",
        "flag",
        "Whether three vehicles or more, slower than 2 m/s, follow each other with gaps below 10 m.",
        _has_queue,
    ),
)
