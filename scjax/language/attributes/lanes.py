"""Lanes of the ego's road."""

from __future__ import annotations

from scjax.language.analysis.scene_analysis import Analysis
from scjax.language.attributes.base import Attribute

_LANES = (0, 20)


def _same(scene: Analysis) -> int | None:
    return None if scene.section is None else len(scene.section.same)


def _opposite(scene: Analysis) -> int | None:
    return None if scene.section is None else len(scene.section.opposite)


def _total(scene: Analysis) -> int | None:
    return None if scene.section is None else len(scene.section.same) + len(scene.section.opposite)


def _ego_lane(scene: Analysis) -> tuple[str, ...]:
    """Names of the ego's lane; none on a road of one lane."""
    section = scene.section
    if section is None or len(section.same) < 2:
        return ()
    last = len(section.same) - 1
    return ("leftmost",) if section.index == 0 else ("rightmost",) if section.index == last else ("middle",)


LANES = (
    Attribute(
        "one_way",
        "flag",
        "Whether no lane of the ego's road runs against it.",
        lambda scene: None if scene.section is None else not scene.section.opposite,
    ),
    Attribute(
        "lanes_same", "range", "Lanes of the ego's road with its direction, its own included.", _same, limits=_LANES
    ),
    Attribute("lanes_opposite", "range", "Lanes of the ego's road against its direction.", _opposite, limits=_LANES),
    Attribute("lanes_total", "range", "Lanes of the ego's road in both directions.", _total, limits=_LANES),
    Attribute(
        "median",
        "flag",
        "Whether more than 2 m lie between the two directions of the ego's road.",
        lambda scene: None if scene.section is None else scene.section.median,
    ),
    Attribute(
        "turn_lane",
        "set",
        "Directions of the lanes on the ego's approach that lead to a turn only.",
        lambda scene: scene.turn_lanes,
        ("left", "right"),
    ),
    Attribute(
        "ego_lane",
        "choice",
        "Place of the ego's lane among two or more of its direction.",
        _ego_lane,
        ("leftmost", "middle", "rightmost"),
    ),
    Attribute(
        "ego_lane_index",
        "range",
        "Number of the ego's lane, counted from the left of its direction; the first is 1.",
        lambda scene: None if scene.section is None else scene.section.index + 1,
        limits=(1, 20),
    ),
)
