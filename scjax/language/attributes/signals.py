"""Traffic lights."""

from __future__ import annotations

from scjax.language.analysis.routes import reachable_lanes
from scjax.language.analysis.scene_analysis import Analysis
from scjax.language.attributes.base import Attribute
from scjax.scene import Signal

NAMES = {Signal.GO: "green", Signal.CAUTION: "yellow", Signal.STOP: "red"}
_REACH = 34.0  # m ahead


def _signal(scene: Analysis) -> tuple[str, ...]:
    """The state of the first lane with one ahead on the straight way, else on a turn, else of the ego's own lane."""
    lines, route = scene.lines, scene.route
    if not (lines.signals != Signal.UNKNOWN).any():
        return ("none",)
    if route is None:
        return ("any",)
    lanes = [*route.ahead.lanes[1:], *reachable_lanes(lines, route.lane, route.point, _REACH), route.lane]
    state = next((int(lines.signals[k]) for k in lanes if lines.signals[k] != Signal.UNKNOWN), None)
    return ("any",) if state is None else (NAMES[Signal(state)], "any")


SIGNALS = (
    Attribute(
        "signal",
        "choice",
        "State shown to the ego's lane ahead; none: no lane of the scene has a state, any: some lane has one.",
        _signal,
        ("red", "yellow", "green", "none", "any"),
    ),
)
