"""Obstacles of a CommonRoad file -> tracks of objects over time."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from scjax.data.readers.commonroad.lanelets import point_of
from scjax.data.readers.scene_json import MAX_STATES
from scjax.data.readers.vocabulary import BICYCLE, OBJECT_WORDS, look_up
from scjax.data.readers.xml_elements import Element
from scjax.scene import OTHER_OBJECT, AgentType
from scjax.scene.limits import MAX_COORDINATE

_TAGS = ("obstacle", "dynamicObstacle", "staticObstacle")
_NOT_READ = ("environmentObstacle", "phantomObstacle", "planningProblem")
_COLUMNS = ("x", "y", "z", "heading", "vx", "vy")


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Objects over T steps, from step 0 of the file on.

    Attributes:
      ids, types: of each object, as in ``Log``.
      sizes: length, width, height [m]; NaN where not recorded.
      states: x, y, z [m], heading [rad], vx, vy [m/s] of each object at every step; NaN in x where not observed.
    """

    ids: tuple[str, ...]
    types: np.ndarray
    sizes: np.ndarray
    states: np.ndarray


def read_obstacles(root: Element, unknown: Counter[str], notes: Counter[str]) -> Tracks:
    """All static and dynamic obstacles. A file without any has one step.

    Args:
      unknown, notes: count words that no table has, and what is not read.

    Raises:
      ValueError: something is missing or absurd; says where.
    """
    for tag in _NOT_READ:
        if count := len(root.all(tag)):
            notes[f"{tag}s, not read"] += count
    elements = [element for element in root.children if element.tag in _TAGS]
    histories = [_history(element, notes) for element in elements]
    steps = 1 + max((step for history in histories for step in history), default=0)
    if steps * max(len(elements), 1) > MAX_STATES:
        raise ValueError(f"{len(elements)} obstacles at {steps} steps are more than {MAX_STATES}: split the scenario")
    states = np.full((len(elements), steps, len(_COLUMNS)), np.nan)
    for row, (element, history) in enumerate(zip(elements, histories, strict=True)):
        if _is_static(element):
            states[row] = history[min(history)]
            states[row, :, 4:] = 0.0
        else:
            for step, values in history.items():
                states[row, step] = values
    types = [look_up(OBJECT_WORDS, _type_word(element), OTHER_OBJECT, "obstacle type", unknown) for element in elements]
    types = [AgentType.CYCLIST if value == BICYCLE else value for value in types]  # they take part in traffic
    return Tracks(
        ids=tuple(element.text("id") for element in elements),
        types=np.array(types, np.int32).reshape(-1),
        sizes=np.array([_size(element) for element in elements], np.float64).reshape(-1, 3),
        states=states,
    )


def _is_static(element: Element) -> bool:
    role = element.first("role")
    return element.tag == "staticObstacle" or (role is not None and role.content == "static")


def _type_word(element: Element) -> str:
    kind = element.first("type")
    return "" if kind is None else kind.content


def _size(element: Element) -> list[float]:
    """Length, width and height [m] of the shape; NaN where it does not say."""
    shape = element.first("shape")
    for child in shape.children if shape is not None else ():
        if child.tag == "rectangle":
            return [child.only("length").value(), child.only("width").value(), math.nan]
        if child.tag == "circle":
            diameter = 2 * child.only("radius").value()
            return [diameter, diameter, math.nan]
        if child.tag == "polygon":
            points = np.array([point_of(point) for point in child.all("point")]).reshape(-1, 3)
            if len(points):
                return [*(points.max(0) - points.min(0))[:2].tolist(), math.nan]
    return [math.nan] * 3


def _history(element: Element, notes: Counter[str]) -> dict[int, list[float]]:
    """Step -> the six values of the state, of the initial state and the trajectory."""
    trajectory = element.first("trajectory")
    items = [element.only("initialState"), *(trajectory.all("state") if trajectory is not None else ())]
    if element.first("occupancySet") is not None:
        notes["occupancy sets of obstacles, not read"] += 1
    history: dict[int, list[float]] = {}
    for item in items:
        step = int(_number(item.only("time"), "time"))
        if not 0 <= step <= MAX_STATES:
            raise item.fault(f"its time step is {step}: steps count from 0")
        history[step] = _state(item)
    return history


def _state(element: Element) -> list[float]:
    x, y, z = _place(element.only("position"))
    orientation, speed, aside = (element.first(tag) for tag in ("orientation", "velocity", "velocityY"))
    ahead = 0.0 if speed is None else _number(speed, "velocity")
    across = 0.0 if aside is None else _number(aside, "velocityY")
    if orientation is None:  # point-mass states have two velocities in the frame of the map
        return [x, y, z, math.atan2(across, ahead) if ahead or across else 0.0, ahead, across]
    heading = _number(orientation, "orientation")
    cos, sin = math.cos(heading), math.sin(heading)
    return [x, y, z, heading, ahead * cos - across * sin, ahead * sin + across * cos]


def _place(element: Element) -> list[float]:
    """A point, or the middle of the shape in which an object is."""
    point = element.first("point")
    if point is not None:
        return point_of(point)
    for shape in element.children:
        center = shape.first("center")
        if center is not None:
            return [*(center.only(axis).value(MAX_COORDINATE) for axis in ("x", "y")), math.nan]
        if shape.all("point"):
            return _mean([point_of(item) for item in shape.all("point")])
    raise element.fault("holds neither a point nor a shape with a center")


def _mean(points: Sequence[Sequence[float]]) -> list[float]:
    return np.array(points).mean(0).tolist()


def _number(element: Element, name: str) -> float:
    """An exact value, or the middle of an interval."""
    exact = element.first("exact")
    if exact is not None:
        return exact.value()
    start, end = element.first("intervalStart"), element.first("intervalEnd")
    if start is None or end is None:
        raise element.fault(f"its {name} is neither exact nor an interval")
    return (start.value() + end.value()) / 2
