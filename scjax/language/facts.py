"""Facts of a scene: everything that a caption can say, as plain values with a JSON form."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import numpy as np

from scjax.language.analysis.rings import count_ring_roads
from scjax.language.analysis.scene_analysis import analyze
from scjax.language.ego_road import (
    Curve,
    RoadChange,
    cross_section,
    curve,
    ego_lane,
    ego_options,
    ego_path,
    road_changes,
)
from scjax.language.events import find_events
from scjax.language.intersections import EgoSide, Intersection, IntersectionType, find_intersections
from scjax.language.road import Road, road_from_scene, wrap_to_pi
from scjax.language.traffic import Traffic, count_traffic
from scjax.language.turn_lanes import find_turn_lanes
from scjax.metrics.pooling import singles
from scjax.scene import AgentType, Scene, Signal
from scjax.scene.document import convert_document

FORMAT = 2
RoadLayout = Literal[
    "no road",
    "straight",
    "curve",
    "winding",
    "four-way",
    "T",
    "complex",
    "roundabout",
    "parking area",
    "intersection at the edge",
    "side road",
    "several side streets",
    "lane added",
    "lane ends",
    "split",
    "merge",
    "junction at the edge",
]

LIGHTS: dict[str, Signal] = {"green": Signal.GO, "yellow": Signal.CAUTION, "red": Signal.STOP}
_EDGE_DISTANCE = 29.0  # m from the ego, beyond which an intersection is at the edge of view
_MAX_CONTINUATION_ANGLE = np.deg2rad(35.0)  # between the ego's heading and an arm that continues its road
_MANY_INTERSECTIONS = 3
_EGO_OFFSET, _EGO_YAW = 2.0, 0.2  # m, rad; a sampled ego stands so near to the origin
# A parking area has many short lanes and slow vehicles only.
_PARKING_MIN_LANES = 20
_PARKING_MAX_LANE_LENGTH = 30.0  # m
_PARKING_MAX_SPEED = 3.0  # m/s
_CHANGE_PRIORITY: tuple[RoadChange, ...] = (
    "split",
    "merge",
    "side road",
    "lane added",
    "lane ends",
    "junction at the edge",
)


@dataclasses.dataclass(frozen=True)
class Facts:
    """Facts of a scene; the field names are the keys of the JSON form.

    Attributes:
      layout: main feature of the road network.
      curve: shape of the ego's road within 30 m; None where the ego is on no lane.
      lanes_same, lanes_opposite: lanes of the ego's road with and against its direction; 0, 0 off the road.
      lane_index: the ego's lane counted from the left, first is 1; 0 off the road.
      centre_turn_lane, median: whether the ego's road has one.
      intersection: type of the intersection with most crossings.
      intersection_side, intersection_distance: its position relative to the ego; distance in steps of 10 m.
      side_streets_left, side_streets_right: T-intersections along the ego's road.
      turn_lanes: directions of the dedicated turn lanes on the ego's approach.
      ego_turn_lane: direction of the turn lane that the ego is in.
      ego_options: movements of the ego at the next fork.
      bridge: lanes pass over each other.
      signals: state ahead of the ego, "green", "yellow", "red" or "other"; None where no signals are recorded.
      events: rare events, each at most once.
      traffic: numbers of agents by relation to the ego.
      has_ego: whether agent 0 is a vehicle; without an ego nothing is said relative to it.
    """

    layout: RoadLayout
    curve: Curve | None = None
    lanes_same: int = 0
    lanes_opposite: int = 0
    lane_index: int = 0
    centre_turn_lane: bool = False
    median: bool = False
    intersection: IntersectionType | None = None
    intersection_side: EgoSide | None = None
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
    has_ego: bool = True

    def to_json(self) -> dict[str, Any]:
        """Plain values, with a format number."""
        return {"format": FORMAT, **dataclasses.asdict(self)}

    @classmethod
    def from_json(cls, content: dict[str, Any]) -> Facts:
        """Inverse of ``to_json``.

        Raises:
          ValueError: another format, an unknown field, or a value of another type; names the field.
        """
        values = dict(content)
        if (version := values.pop("format", None)) != FORMAT:
            raise ValueError(f"facts of format {version!r} cannot be read, only {FORMAT}: caption the scenes again")
        known = {field.name for field in dataclasses.fields(cls)}
        if unknown := sorted(set(values) - known):
            raise ValueError(f"facts hold unknown fields: {', '.join(unknown)}")
        return convert_document(values, cls, "facts", "caption the scenes again")


def extract_facts(scene: Scene) -> Facts:
    """The facts of one scene, recorded or generated; agent 0 is the ego if it is a vehicle.

    A scene in another frame than the ego's is read from where the ego is.
    """
    (scene,) = singles(scene)
    has_ego = len(scene.agents) > 0 and int(scene.agent_types[0]) == AgentType.VEHICLE
    scene = seen_from_ego(scene) if has_ego else scene
    road = road_from_scene(scene)
    if not len(road):
        return Facts("no road", traffic=count_traffic(scene, road, None, has_ego=has_ego), has_ego=has_ego)
    facts = _facts_on_road(scene, road, has_ego)
    return facts if has_ego else _without_ego(facts)


def seen_from_ego(scene: Scene) -> Scene:
    """The scene in the frame of agent 0, unless that is its frame already but for a sampled ego's small offset."""
    x, y, cos, sin = (float(scene.agents[0, column]) for column in (0, 1, 4, 5))
    yaw = math.atan2(sin, cos)
    if math.hypot(x, y) < _EGO_OFFSET and abs(yaw) < _EGO_YAW:
        return scene
    agents, lanes = np.array(scene.agents, np.float64), np.array(scene.lanes, np.float64)
    rotation = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])  # of row vectors, by -yaw
    agents[:, :2], agents[:, 4:6] = (agents[:, :2] - [x, y]) @ rotation, agents[:, 4:6] @ rotation
    lanes[..., :2] = (lanes[..., :2] - [x, y]) @ rotation
    return scene.replace(agents=agents.astype(np.float32), lanes=lanes.astype(np.float32))


def _without_ego(facts: Facts) -> Facts:
    """The facts that do not depend on an ego."""
    blank = Facts(facts.layout)
    fields = ("intersection", "bridge", "traffic")
    return dataclasses.replace(blank, has_ego=False, **{name: getattr(facts, name) for name in fields})


def _facts_on_road(scene: Scene, road: Road, has_ego: bool) -> Facts:
    intersections, bridges = find_intersections(road)
    lane = ego_lane(road) if has_ego else None
    path = None if lane is None else ego_path(road, lane)
    streets = _side_streets(intersections)
    values: dict[str, Any] = {
        "bridge": bridges > 0,
        "traffic": count_traffic(scene, road, path, has_ego=has_ego),
        "events": find_events(scene, road, intersections),
        "signals": _signal_ahead(road, lane),
        "side_streets_left": streets["left"],
        "side_streets_right": streets["right"],
    }
    changes: set[RoadChange] = set()
    if lane is not None and path is not None:
        changes = road_changes(road, lane, intersections)
        values |= _ego_road_values(road, lane, path, intersections)
    intersection = _main_intersection(intersections)
    if _is_parking_area(road, scene):
        return Facts("parking area", **values)
    if _is_roundabout(scene):
        return Facts("roundabout", **values)
    if intersection is None:
        return Facts(_road_layout(changes, values.get("curve")), **values)
    layout = _intersection_layout(intersections, intersection, sum(streets.values()))
    if layout != "several side streets":
        values["intersection"] = intersection.type
        if layout == "complex":
            values["intersection"] = "complex"
            intersection = min(intersections, key=lambda item: item.distance)
        values["intersection_side"] = intersection.side
        values["intersection_distance"] = 10 * round(intersection.distance / 10)
    return Facts(layout, **values)


def _ego_road_values(road: Road, lane: int, path: np.ndarray, intersections: list[Intersection]) -> dict[str, Any]:
    """Fields of ``Facts`` about the ego's road."""
    section = cross_section(road, path, intersections)
    turn_lanes = find_turn_lanes(road, intersections, lane)
    return {
        "curve": curve(path, intersections),
        "lanes_same": section.lanes_same,
        "lanes_opposite": section.lanes_opposite,
        "lane_index": section.lane_index,
        "centre_turn_lane": section.center_turn_lane,
        "median": section.median,
        "turn_lanes": tuple(sorted({item.turn for item in turn_lanes if item.on_ego_approach})),
        "ego_turn_lane": next((item.turn for item in turn_lanes if item.has_ego), None),
        "ego_options": tuple(sorted(ego_options(road, lane))),
    }


def _main_intersection(intersections: list[Intersection]) -> Intersection | None:
    """The intersection with most crossings; those at the edge of view count last."""
    inner = [item for item in intersections if item.distance <= _EDGE_DISTANCE or len(item.arms) >= 4]
    return inner[0] if inner else (intersections[0] if intersections else None)


def _side_streets(intersections: list[Intersection]) -> dict[str, int]:
    """T-intersections by the side of the ego to which their only side arm leads."""
    counts = {"left": 0, "right": 0}
    for item in intersections:
        side_arms = [
            arm
            for arm in item.arms
            if min(abs(wrap_to_pi(arm)), abs(wrap_to_pi(arm - np.pi))) > _MAX_CONTINUATION_ANGLE
        ]
        if item.type == "T" and len(side_arms) == 1:
            counts["left" if side_arms[0] > 0 else "right"] += 1
    return counts


def _is_parking_area(road: Road, scene: Scene) -> bool:
    speeds = np.asarray(scene.agents)[:, 3]
    return bool(
        len(road) >= _PARKING_MIN_LANES
        and road.length.max() < _PARKING_MAX_LANE_LENGTH
        and (speeds < _PARKING_MAX_SPEED).all()
    )


def _is_roundabout(scene: Scene) -> bool:
    """Whether lanes run round a ring to which two roads or more lead."""
    analysis = analyze(scene)
    return analysis.ring is not None and count_ring_roads(analysis.lines, analysis.ring) > 1


def _intersection_layout(
    intersections: list[Intersection], intersection: Intersection, num_side_streets: int
) -> RoadLayout:
    """Layout of a road network with the main intersection ``intersection``."""
    is_many = sum(item.distance <= _EDGE_DISTANCE for item in intersections) >= _MANY_INTERSECTIONS
    if is_many and num_side_streets == len(intersections):
        return "several side streets"
    if is_many or intersection.type == "complex":
        return "complex"
    if intersection.distance > _EDGE_DISTANCE and len(intersection.arms) < 4:
        return "intersection at the edge"
    return intersection.type or "complex"


def _road_layout(changes: set[RoadChange], curve_of_road: Curve | None) -> RoadLayout:
    """Layout of a road without intersections."""
    for change in _CHANGE_PRIORITY:
        if change in changes:
            return change
    if curve_of_road in ("left", "right"):
        return "curve"
    return "winding" if curve_of_road == "winding" else "straight"


def _signal_ahead(road: Road, lane: int | None) -> str | None:
    """State of the signals of the ego's lane and its successors; "other" where they differ or none has a signal."""
    if not (road.signals != Signal.UNKNOWN).any():
        return None
    lanes_ahead = [] if lane is None else [lane, *road.successors[lane]]
    states = {int(road.signals[k]) for k in lanes_ahead} - {int(Signal.UNKNOWN)}
    names = {int(state): name for name, state in LIGHTS.items()}
    return names[states.pop()] if len(states) == 1 else "other"
