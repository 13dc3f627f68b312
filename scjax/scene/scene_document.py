"""The JSON form of scenes: its types, which are also the published schema, and scenes from it.

docs/scene-json.md describes the form for people, docs/scene.schema.json for programs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType

from scjax.scene.limits import MAX_COORDINATE, MAX_SIZE, MAX_SLOTS, MAX_SPEED
from scjax.scene.polyline import resample_polyline
from scjax.scene.scene import POINTS_PER_LANE, STATE_COLUMNS, AgentType, Crop, Link, Scene, Signal, empty, stack

JSON_FORMAT, JSON_VERSION = "scjax-scene", 1
UNITS = {"x, y, z, length, width, height": "m", "speed": "m/s", "heading": "rad, counter-clockwise from +x"}
# Files keep the names of their first version, which other programs read: "layout" is the crop. Both are read.
CROP_WORDS = {"centred": Crop.CENTERED, **{crop.name.lower(): crop for crop in Crop}}
MAX_CELLS = 1 << 24
"""Pairs of lanes in all scenes of a file below 16 MB: their links are the largest array."""

Id = Annotated[int, Meta(ge=0)] | str
Coordinate = Annotated[float, Meta(gt=-MAX_COORDINATE, lt=MAX_COORDINATE)]
Size = Annotated[float, Meta(gt=0, le=MAX_SIZE)]
CropWord = Literal["centred", "centered", "partitioned", "forward"]
Slots = Annotated[int, Meta(ge=0, le=MAX_SLOTS)]


class AgentRow(Struct, forbid_unknown_fields=True):
    """One agent: position and size [m], speed [m/s], heading [rad]; ``unknown`` names values that are mere fills."""

    id: Id
    type: Literal["vehicle", "pedestrian", "cyclist", "static"]
    x: Coordinate
    y: Coordinate
    z: Coordinate
    speed: Annotated[float, Meta(ge=-MAX_SPEED, le=MAX_SPEED)]
    heading: Annotated[float, Meta(description="radians, counter-clockwise from +x, between -2 pi and 2 pi")]
    length: Size
    width: Size
    height: Size
    unknown: list[Literal["x", "y", "z", "speed", "cos", "sin", "length", "width", "height"]] = []


class LaneRow(Struct, forbid_unknown_fields=True):
    """One lane: its centerline in driving direction, of two points [x, y] or [x, y, z] or more, and its relations."""

    id: Id
    points: Annotated[
        list[Annotated[list[Coordinate], Meta(min_length=2, max_length=3)]], Meta(min_length=2, max_length=100_000)
    ]
    signal: Literal["unknown", "go", "caution", "stop"] = "unknown"
    successors: list[Id] = []
    left: list[Id] = []
    right: list[Id] = []
    unknown: list[Literal["x", "y", "z"]] = []


class SceneRow(Struct, forbid_unknown_fields=True):
    """One scene; ``layout`` and ``crop`` are two names of the same field."""

    agents: list[AgentRow]
    lanes: list[LaneRow]
    domain: Annotated[int, Meta(ge=0, lt=2**31)] = 0
    layout: CropWord | UnsetType = UNSET
    crop: CropWord | UnsetType = UNSET


class SceneFile(Struct, forbid_unknown_fields=True):
    """A file of scenes. All but ``format``, ``version`` and ``scenes`` may be left out."""

    format: Literal["scjax-scene"]
    version: Literal[1]
    scenes: list[SceneRow]
    units: dict[str, str] = {}
    batch_shape: list[Slots] | UnsetType = UNSET
    agent_slots: Slots = 0
    lane_slots: Slots = 0
    points_per_lane: Literal[20] = POINTS_PER_LANE


class FileVersion(Struct):
    """What is read first, to say that a file is of another format or version rather than broken."""

    format: Any = None
    version: Any = None


def scenes_of(content: SceneFile, name: str, size: int) -> Scene:
    """The scene or batch of a file, not validated yet.

    Args:
      size: of the file [bytes]; it bounds what its scenes may take in memory.

    Raises:
      ValueError: starting with ``name``: units, numbers of slots, ids or links that do not fit.
    """
    for column, unit in content.units.items():
        if unit != UNITS.get(column):
            raise ValueError(f"{name}: units: {column!r} in {unit!r}: files hold {UNITS}: convert the values")
    lead = [len(content.scenes)] if content.batch_shape is UNSET else content.batch_shape
    if math.prod(lead) != len(content.scenes):
        raise ValueError(f"{name}: batch_shape {lead} does not fit {len(content.scenes)} scenes: correct one of them")
    agents = max([content.agent_slots, *(len(row.agents) for row in content.scenes)])
    lanes = max([content.lane_slots, *(len(row.lanes) for row in content.scenes)])
    cells = len(content.scenes) * (lanes * lanes + agents)
    if max(agents, lanes) > MAX_SLOTS or cells > max(MAX_CELLS, size):
        raise ValueError(
            f"{name}: {len(content.scenes)} scenes of {agents} agent and {lanes} lane slots are more than a file of "
            f"{size / 1e6:.1f} MB may hold, and a scene at most {MAX_SLOTS} of each: split the file or crop the scenes"
        )
    if not content.scenes:
        fields = empty(agents, lanes).to_dict().items()
        return Scene(**{field: np.zeros((*lead, *value.shape), value.dtype) for field, value in fields})
    batch = stack([_scene_of(row, (agents, lanes), f"{name}, scene {i}") for i, row in enumerate(content.scenes)])
    return Scene(**{field: value.reshape((*lead, *value.shape[1:])) for field, value in batch.to_dict().items()})


def _scene_of(row: SceneRow, slots: tuple[int, int], name: str) -> Scene:
    agent_slots = _slots_of([agent.id for agent in row.agents], slots[0], f"{name}, agents")
    lane_slots = _slots_of([lane.id for lane in row.lanes], slots[1], f"{name}, lanes")
    if row.layout and row.crop and CROP_WORDS[row.layout] != CROP_WORDS[row.crop]:
        raise ValueError(f"{name}: layout is {row.layout!r} and crop {row.crop!r}, one field by two names: keep one")
    scene = empty(*slots, crop=CROP_WORDS[row.layout or row.crop or "centred"], domain=row.domain)
    for agent in row.agents:
        _fill_agent(scene, agent_slots[agent.id], agent, f"{name}, agent {agent.id}")
    for lane in row.lanes:
        _fill_lane(scene, lane_slots[lane.id], lane, f"{name}, lane {lane.id}")
    for lane in row.lanes:
        _fill_links(scene, lane, lane_slots, f"{name}, lane {lane.id}")
    return scene


def _slots_of(ids: Sequence[int | str], slots: int, name: str) -> dict[int | str, int]:
    """Slot of every id: the id itself if all are whole numbers below the number of slots, else the place in the list.

    A file that scjax wrote has slots as ids, with holes for padding; ids of other sources are mere names.
    """
    if len(set(ids)) < len(ids):
        repeated = next(value for value in ids if list(ids).count(value) > 1)
        raise ValueError(f"{name}: the id {repeated!r} is used twice: ids must differ")
    if all(isinstance(value, int) and value < slots for value in ids):
        return {value: int(value) for value in ids}
    return {value: place for place, value in enumerate(ids)}


def _fill_agent(scene: Scene, i: int, agent: AgentRow, name: str) -> None:
    heading = agent.heading
    if not abs(heading) <= 2 * math.pi + 1e-6:
        raise ValueError(
            f"{name}: heading is {heading:g}: headings are radians between -2 pi and 2 pi, counter-clockwise from +x"
            + (f"; if it is degrees, write {math.radians(heading):.6g}" if abs(heading) <= 360 else ": correct it")
        )
    values = {column: getattr(agent, column, None) for column in STATE_COLUMNS}
    values |= {"cos": math.cos(heading), "sin": math.sin(heading)}
    scene.agents[i] = [values[column] for column in STATE_COLUMNS]
    scene.agent_types[i] = AgentType[agent.type.upper()]
    scene.agent_known[i] = [column not in agent.unknown for column in STATE_COLUMNS]
    scene.agent_mask[i] = True


def _fill_lane(scene: Scene, i: int, lane: LaneRow, name: str) -> None:
    columns = {len(point) for point in lane.points}
    if len(columns) > 1:
        raise ValueError(f"{name}: some points have z and some have not: give it to all points or to none")
    points = np.array(lane.points, np.float64)
    has_z = points.shape[1] == 3
    if not has_z:
        points = np.concatenate([points, np.zeros((len(points), 1))], 1)
    if len(points) != POINTS_PER_LANE:
        if not np.hypot(*np.diff(points[:, :2], axis=0).T).sum() > 0:
            raise ValueError(f"{name}: all points are one place: give the centerline, at least two different points")
        points = resample_polyline(points, POINTS_PER_LANE)
    scene.lanes[i] = points
    scene.lane_known[i] = [column not in lane.unknown and (column != "z" or has_z) for column in "xyz"]
    scene.signals[i] = Signal[lane.signal.upper()]
    scene.lane_mask[i] = True
    scene.links[i, i] = Link.SELF


def _fill_links(scene: Scene, lane: LaneRow, slots: dict[int | str, int], name: str) -> None:
    """``successors`` of i: PREDECESSOR in row i. ``left`` of i names j: j is the left neighbor, LEFT in row j."""
    i = slots[lane.id]
    for key, inverse, link in (
        ("successors", Link.SUCCESSOR, Link.PREDECESSOR),
        ("left", Link.LEFT, Link.RIGHT),
        ("right", Link.RIGHT, Link.LEFT),
    ):
        for other in getattr(lane, key):
            j = slots.get(other)
            if j is None or j == i:
                raise ValueError(f"{name}: {key} names {other!r}, which is not the id of another lane: correct it")
            if scene.links[i, j] == link:
                continue
            # A ring of two lanes is the one pair that may hold the same relation, PREDECESSOR, both ways.
            ring = link == Link.PREDECESSOR and scene.links[i, j] == Link.SUCCESSOR
            if not ring and scene.links[i, j] != Link.NONE:
                raise ValueError(
                    f"{name}: {key} names {other!r}, which is linked to it in another way as well: keep one"
                )
            scene.links[i, j], scene.links[j, i] = link, Link.PREDECESSOR if ring else inverse
