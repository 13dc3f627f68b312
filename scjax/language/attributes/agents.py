"""Numbers of agents in the scene; the ego counts nowhere."""

from __future__ import annotations

import itertools

import numpy as np

from scjax.language.analysis.scene_analysis import Analysis
from scjax.language.attributes.base import Attribute, count_of
from scjax.scene import AgentType
from scjax.scene.scene import LARGE_LENGTH

_STANDING = 0.5  # m/s
_ROAD_HALF_WIDTH = 1.75  # m
_AHEAD_ANGLE = np.deg2rad(30.0)
_SIDE_ANGLE = np.deg2rad(60.0)  # to either side of the ego's heading and of its back
CLASSES = {
    "vehicles": AgentType.VEHICLE,
    "pedestrians": AgentType.PEDESTRIAN,
    "cyclists": AgentType.CYCLIST,
    "static": AgentType.STATIC,
}
SIDES = ("ahead", "behind", "left", "right")


def _rows(scene: Analysis, name: str) -> np.ndarray:
    return scene.is_type(CLASSES[name]) & (np.arange(len(scene.types)) > 0)


def _bearing(scene: Analysis) -> np.ndarray:
    """Direction of every agent, seen from the ego [rad]; 0 is straight ahead."""
    offset = scene.agents[:, :2] - scene.ego[:2]
    cos, sin = scene.ego[4:6]
    return np.arctan2(cos * offset[:, 1] - sin * offset[:, 0], cos * offset[:, 0] + sin * offset[:, 1])


def _pedestrians_ahead(scene: Analysis) -> int:
    return count_of(_rows(scene, "pedestrians") & (np.abs(_bearing(scene)) < _AHEAD_ANGLE))


def _parked(scene: Analysis) -> int:
    rows = scene.parked_vehicles
    if scene.has_parking_rows:
        rows = rows | (scene.vehicles & (scene.speeds < 0.3))
    return count_of(rows)


def _where(scene: Analysis) -> tuple[str, ...]:
    """Every class with every side on which it is."""
    bearing = _bearing(scene)
    sides = {
        "ahead": np.abs(bearing) < _SIDE_ANGLE,
        "behind": np.abs(bearing) > np.pi - _SIDE_ANGLE,
        "left": (bearing > 0) & (bearing < np.pi),
        "right": (bearing < 0) & (bearing > -np.pi),
    }
    groups = {name: _rows(scene, name) for name in CLASSES} | {"parked": scene.parked_vehicles}
    return tuple(f"{name} {side}" for name, rows in groups.items() for side in SIDES if (rows & sides[side]).any())


def _compare(scene: Analysis) -> tuple[str, ...]:
    """Pairs of classes of which the first has more agents."""
    counts = {name: count_of(_rows(scene, name)) for name in CLASSES}
    return tuple(f"{a} > {b}" for a, b in itertools.permutations(CLASSES, 2) if counts[a] > counts[b])


def _number(name: str, meaning: str) -> Attribute:
    return Attribute(name, "range", meaning, lambda scene: count_of(_rows(scene, name)))


AGENTS = (
    _number("vehicles", "Vehicles in the scene, besides the ego."),
    _number("pedestrians", "Pedestrians in the scene."),
    _number("cyclists", "Cyclists in the scene."),
    _number("static", "Cones, barriers and other static objects in the scene."),
    Attribute(
        "large",
        "range",
        "Vehicles longer than 7 m, such as buses and trucks.",
        lambda scene: count_of(scene.vehicles & (scene.agents[:, 6] > LARGE_LENGTH)),
    ),
    Attribute(
        "parked",
        "range",
        "Vehicles slower than 0.3 m/s that stand more than 1.4 m off the middle of every lane, or in a parking lot.",
        _parked,
    ),
    Attribute(
        "stopped",
        "range",
        "Vehicles slower than 0.5 m/s.",
        lambda scene: count_of(scene.vehicles & (scene.speeds < _STANDING)),
    ),
    Attribute(
        "pedestrians_on_road",
        "range",
        "Pedestrians within 1.75 m of the middle of a lane.",
        lambda scene: count_of(_rows(scene, "pedestrians") & (scene.relations.offset < _ROAD_HALF_WIDTH)),
    ),
    Attribute(
        "pedestrians_ahead",
        "range",
        "Pedestrians within 30 degrees of straight ahead of the ego.",
        _pedestrians_ahead,
    ),
    Attribute(
        "where",
        "set",
        "Sides of the ego on which agents are: left and right of it, and within 60 degrees of its front and back.",
        _where,
        tuple(f"{name} {side}" for name in (*CLASSES, "parked") for side in SIDES),
    ),
    Attribute(
        "compare",
        "set",
        "Pairs of classes of which the first has more agents.",
        _compare,
        tuple(f"{a} > {b}" for a, b in itertools.permutations(CLASSES, 2)),
    ),
)
