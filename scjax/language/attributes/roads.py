"""What the road is: its layout, bends, the ego's arm and the slope."""

from __future__ import annotations

import numpy as np

from scjax.language.analysis.layouts import REACH, route_turns
from scjax.language.analysis.scene_analysis import Analysis
from scjax.language.attributes.base import Attribute
from scjax.scene.angles import wrap_to_pi

LAYOUTS = (
    "straight",
    "curve",
    "winding",
    "four-way",
    "T",
    "Y",
    "roundabout",
    "merge",
    "split",
    "dead-end",
    "parking-lot",
    "intersection",
    "no-intersection",
    "multi-intersection",
    "crossing-overpass",
)
AHEAD = 30.0
"""Length of the ego's way over which bends and slopes are measured [m]."""
_MIN_BEND = np.deg2rad(12.0)
_MIN_RISE = 0.6  # m
_MAX_ARM_DISTANCE = 12.0  # m between the ego's way and a junction that it reaches


def _bend(scene: Analysis) -> tuple[str, ...]:
    if scene.route is None:
        return ()
    route = scene.route
    turn, _, _ = route_turns(route.points_ahead(AHEAD)[:, 3])
    return ("left",) if turn > _MIN_BEND else ("right",) if turn < -_MIN_BEND else ()


def _ego_arm(scene: Analysis) -> tuple[str, ...]:
    """By the direction in which the ego's way enters the nearest T."""
    if scene.route is None:
        return ()
    route = scene.route
    for item in scene.crossroads:
        stem = item.stem
        distance = np.hypot(*(route.points[:, :2] - item.center).T)
        if stem is None or np.hypot(*item.center) > REACH + item.radius or distance.min() > _MAX_ARM_DISTANCE:
            continue
        before = np.flatnonzero((distance > item.radius) & (np.arange(len(distance)) < distance.argmin()))
        point = int(before[-1]) if len(before) else 0
        angle = abs(float(wrap_to_pi(route.points[point, 3] - stem)))
        return ("stem",) if min(angle, np.pi - angle) < np.pi / 4 else ("through",)
    return ()


def _slope(scene: Analysis) -> tuple[str, ...]:
    if scene.route is None:
        return ()
    heights = scene.route.points_ahead(AHEAD)[:, 2]
    rise = float(heights[-1] - heights[0])
    return ("up",) if rise > _MIN_RISE else ("down",) if rise < -_MIN_RISE else ("flat",)


ROADS = (
    Attribute(
        "layout",
        "choice",
        "What the road is within 32 m of the ego; several words may fit.",
        lambda scene: scene.layouts,
        LAYOUTS,
    ),
    Attribute(
        "not_layout",
        "choice",
        "What the road is not within 32 m of the ego.",
        lambda scene: tuple(name for name in LAYOUTS if name not in scene.layouts),
        LAYOUTS,
    ),
    Attribute(
        "bend",
        "choice",
        "Side to which the ego's road bends by more than 12 degrees within 30 m ahead.",
        _bend,
        ("left", "right"),
    ),
    Attribute(
        "ego_arm",
        "choice",
        "At a T-intersection, whether the ego is on its stem or on the through road.",
        _ego_arm,
        ("stem", "through"),
    ),
    Attribute(
        "slope",
        "choice",
        "Change of the height of the ego's road over 30 m ahead: more than 0.6 m, less than -0.6 m, or between.",
        _slope,
        ("up", "down", "flat"),
    ),
)
