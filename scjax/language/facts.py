"""Everything the captioner can say about a scene, as plain values that go to JSON and back."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

from scjax.language.ego_road import (
    Curve,
    Joint,
    cross_section,
    curve,
    ego_lane,
    ego_options,
    ego_path,
    joints,
)
from scjax.language.events import find_events
from scjax.language.intersections import Intersection, Kind, Side, find_intersections, has_roundabout
from scjax.language.road import Road, road_of, wrapped
from scjax.language.traffic import Traffic, traffic_of
from scjax.language.turn_lanes import find_turn_lanes
from scjax.metrics.pooling import singles
from scjax.scene import Scene, Signal

FORMAT = 2
RoadLayout = Literal[
    "no road", "straight", "curve", "winding", "four-way", "T", "complex", "roundabout", "parking area",
    "intersection at the edge", "side road", "several side streets", "lane added", "lane ends", "split", "merge",
    "junction at the edge",
]  # fmt: skip

LIGHTS: dict[str, Signal] = {"green": Signal.GO, "yellow": Signal.CAUTION, "red": Signal.STOP}
_EDGE = 29.0  # metres from the ego beyond which an intersection is at the edge of view
_ALONG = np.deg2rad(35.0)  # between the ego's road and an arm that continues it
_PARKING = (20, 30.0, 3.0)  # lanes at least, longest lane [m], fastest vehicle [m/s] of a parking area


@dataclasses.dataclass(frozen=True)
class Facts:
    """Facts of a scene.

    Attributes:
      layout: what the scene is first of all.
      curve: shape of the ego's road within 30 m; None where the ego is on no lane.
      lanes_same, lanes_opposite: lanes of the ego's road with it and against it; 0, 0 off the road.
      lane_index: the ego's lane counted from the left, 1 first.
      centre_turn_lane, median: of the ego's road.
      intersection, intersection_side, intersection_distance: the most crossed one, its place seen by the ego [10 m].
      side_streets_left, side_streets_right: T-intersections along the ego's road.
      turn_lanes: turns with a dedicated lane, on the ego's approach; ego_turn_lane: the one the ego is in.
      ego_options: where the ego may go at the next fork.
      bridge: lanes pass over each other.
      signals: None where none is recorded; else the state of the ego's way ahead, "green", "yellow", "red" or "other".
      events: rare ones, of which each is named once.
      traffic: numbers of agents by relation to the ego.
    """

    layout: RoadLayout
    curve: Curve | None = None
    lanes_same: int = 0
    lanes_opposite: int = 0
    lane_index: int = 0
    centre_turn_lane: bool = False
    median: bool = False
    intersection: Kind | None = None
    intersection_side: Side | None = None
    intersection_distance: int | None = None
    side_streets_left: int = 0
    side_streets_right: int = 0
    turn_lanes: tuple[str, ...] = ()
    ego_turn_lane: str | None = None
    ego_options: tuple[str, ...] = ()
    bridge: bool = False
    signals: str | None = None
    events: tuple[str, ...] = ()
    traffic: Traffic = dataclasses.field(default_factory=Traffic)

    def to_json(self) -> dict[str, Any]:
        """Plain values, with a format number."""
        return {"format": FORMAT, **dataclasses.asdict(self)}

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Facts:
        """Inverse of ``to_json``.

        Raises:
          ValueError: another format, or an unknown field.
        """
        values = dict(content)
        if (found := values.pop("format", None)) != FORMAT:
            raise ValueError(f"facts of format {found!r} cannot be read, only {FORMAT}: caption the scenes again")
        known = {field.name for field in dataclasses.fields(cls)}
        if unknown := sorted(set(values) - known):
            raise ValueError(f"facts hold unknown fields: {', '.join(unknown)}")
        values["traffic"] = Traffic(**values.get("traffic", {}))
        for name in ("turn_lanes", "ego_options", "events"):
            values[name] = tuple(values.get(name, ()))
        return cls(**values)


def extract_facts(scene: Scene) -> Facts:
    """The facts of one scene, recorded or generated, whose agent 0 is the ego."""
    (scene,) = singles(scene)
    road = road_of(scene)
    if not len(road):
        return Facts("no road", traffic=traffic_of(scene, road, None))
    intersections, bridges = find_intersections(road)
    lane = ego_lane(road)
    path = None if lane is None else ego_path(road, lane)
    values: dict[str, Any] = {"bridge": bridges > 0, "traffic": traffic_of(scene, road, path)}
    values["events"] = find_events(scene, road, intersections)
    merges = []
    if lane is not None and path is not None:
        section = cross_section(road, path, intersections)
        merges = joints(road, lane, intersections)
        turns = find_turn_lanes(road, intersections, lane)
        values |= {
            "curve": curve(path, intersections), "lanes_same": section.same, "lanes_opposite": section.opposite,
            "lane_index": section.index, "centre_turn_lane": section.centre_turn, "median": section.median,
            "turn_lanes": tuple(sorted({turn.turn for turn in turns if turn.ego})),
            "ego_turn_lane": next((turn.turn for turn in turns if turn.holds_ego), None),
            "ego_options": tuple(sorted(ego_options(road, lane))),
        }  # fmt: skip
    streets = _side_streets(intersections)
    values |= {"side_streets_left": streets["left"], "side_streets_right": streets["right"]}
    main = _main(intersections)
    layout = _layout(road, scene, intersections, main, merges, values.get("curve"), streets)
    if main is not None and layout not in ("parking area", "several side streets", "roundabout"):
        kind = "complex" if layout == "complex" else main.kind
        if layout == "complex":  # of several intersections the nearest matters most
            main = min(intersections, key=lambda item: item.distance)
        values |= {"intersection": kind, "intersection_side": main.side}
        values["intersection_distance"] = 10 * round(main.distance / 10)
    return Facts(layout, signals=_signals(road, lane), **values)


def _main(intersections: list[Intersection]) -> Intersection | None:
    """The intersection that a scene is about: the one with most crossings that is not at the edge of view."""
    inner = [item for item in intersections if item.distance <= _EDGE or len(item.arms) >= 4]
    return inner[0] if inner else (intersections[0] if intersections else None)


def _side_streets(intersections: list[Intersection]) -> dict[str, int]:
    """T-intersections whose one arm leaves the ego's direction, by its side."""
    found = {"left": 0, "right": 0}
    for item in intersections:
        aside = [arm for arm in item.arms if min(abs(wrapped(arm)), abs(wrapped(arm - np.pi))) > _ALONG]
        if item.kind == "T" and len(aside) == 1:
            found["left" if aside[0] > 0 else "right"] += 1
    return found


def _layout(
    road: Road, scene: Scene, intersections: list[Intersection], main: Intersection | None, merges: list,
    bend: Curve | None, streets: dict[str, int],
) -> RoadLayout:  # fmt: skip
    lanes, longest, fastest = _PARKING
    if len(road) >= lanes and road.length.max() < longest and (np.asarray(scene.agents)[:, 3] < fastest).all():
        return "parking area"
    if has_roundabout(road):
        return "roundabout"
    if main is not None:
        many = sum(item.distance <= _EDGE for item in intersections) >= 3
        if many and sum(streets.values()) == len(intersections):
            return "several side streets"
        if many or main.kind == "complex":
            return "complex"
        if main.distance > _EDGE and len(main.arms) < 4:
            return "intersection at the edge"
        return main.kind or "complex"
    order: tuple[Joint, ...] = ("split", "merge", "side road", "lane added", "lane ends", "junction at the edge")
    kinds = {kind for kind, _, _ in merges}
    for kind in order:
        if kind in kinds:
            return kind
    if bend in ("left", "right"):
        return "curve"
    return "winding" if bend == "winding" else "straight"


def _signals(road: Road, lane: int | None) -> str | None:
    """State of the signals: of the ego's lane or of the lanes that follow it, else of others."""
    if not (road.signal != Signal.UNKNOWN).any():
        return None
    ahead = [] if lane is None else [lane, *road.successors[lane]]
    states = {int(road.signal[k]) for k in ahead} - {int(Signal.UNKNOWN)}
    names = {int(state): name for name, state in LIGHTS.items()}
    return names[states.pop()] if len(states) == 1 else "other"
