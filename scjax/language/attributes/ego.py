"""What the ego does."""

from __future__ import annotations

import numpy as np

from scjax.language.analysis.routes import pose_after
from scjax.language.analysis.scene_analysis import Analysis
from scjax.language.attributes.base import Attribute
from scjax.scene.angles import wrap_to_pi

_STANDING, _SLOW, _FAST = 0.5, 4.0, 12.0  # m/s
_TURN = np.deg2rad(35.0)
_AHEAD, _MERGE_REACH = 25.0, 25.0  # m


def _speed(scene: Analysis) -> tuple[str, ...]:
    if not len(scene.agents):
        return ()
    speed = float(scene.speeds[0])
    if speed < _STANDING:
        return ("stopped",)
    names = ("slow", "moving") if speed <= _SLOW else ("moving",)
    return ("fast", "moving") if speed > _FAST else names


def _manoeuvre(scene: Analysis) -> tuple[str, ...]:
    """Where the only way ahead leads; several ways tell nothing."""
    route = scene.route
    if route is None:
        return ()
    lines = scene.lines
    merges = [item for item in scene.partings if item.is_split and not item.is_fork and route.lane in item.branches]
    rest = float(lines.length[route.lane]) - route.point * float(lines.spacing[route.lane])
    if merges and rest < _MERGE_REACH:
        return ("merge",)
    if any(
        len(lines.next[lane]) > 1
        for lane, start in zip(route.ahead.lanes, route.ahead.starts, strict=True)
        if start < _AHEAD
    ):
        return ()
    pose, _ = pose_after(lines, route.lane, route.point * float(lines.spacing[route.lane]) + _AHEAD, ahead=True)
    turn = float(wrap_to_pi(pose[2] - route.pose(0.0)[3]))
    return ("left",) if turn > _TURN else ("right",) if turn < -_TURN else ("straight",)


EGO = (
    Attribute(
        "ego",
        "choice",
        "Speed of the ego: stopped below 0.5, slow up to 4, moving above 0.5, fast above 12 m/s.",
        _speed,
        ("stopped", "slow", "moving", "fast"),
    ),
    Attribute(
        "ego_manoeuvre",
        "choice",
        "Where the ego's lane leads within 25 m, if it leads to one place only.",
        _manoeuvre,
        ("left", "right", "straight", "merge"),
    ),
)
