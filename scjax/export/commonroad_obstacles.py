"""Objects as CommonRoad obstacles, and the ego as a planning problem."""

from __future__ import annotations

import numpy as np

from scjax.export.base import Losses
from scjax.export.traffic import without_gaps
from scjax.export.xml_text import XmlElement, add_element, add_point, plain_decimal
from scjax.scene import OTHER_OBJECT, AgentType, Log

_TYPES = {
    AgentType.VEHICLE: "car",
    AgentType.PEDESTRIAN: "pedestrian",
    AgentType.CYCLIST: "bicycle",
    AgentType.STATIC: "constructionZone",
    OTHER_OBJECT: "unknown",
}
_STANDING = 0.5  # m that a static object may move
_SIDEWAYS = 0.001  # m/s
_GOAL_MARGIN = 2.0  # m around the ego's last box


def add_obstacles(root: XmlElement, log: Log, number: int, losses: Losses) -> int:
    """Adds all objects but the ego.

    Args:
      log: of ``filled_traffic``.
      number: id of the first obstacle.

    Returns:
      The next id.
    """
    log = without_gaps(log, losses)
    static = log.object_types == AgentType.STATIC
    for row in [
        *np.flatnonzero(static).tolist(),
        *np.flatnonzero(~static).tolist(),
    ]:  # the schema has static ones first
        if row == log.ego_index:
            continue
        steps = np.flatnonzero(log.valid[row])
        is_static = log.object_types[row] == AgentType.STATIC
        if is_static:
            moved = np.hypot(*(log.positions[row, steps, :2] - log.positions[row, steps[0], :2]).T).max()
            losses["static objects that move, written at their first place"] += int(moved > _STANDING)
            losses["static objects that are not observed at every step, written at all"] += int(
                len(steps) < log.num_steps
            )
        element = add_element(root, "staticObstacle" if is_static else "dynamicObstacle", id=number)
        number += 1
        add_element(element, "type", _TYPES[int(log.object_types[row])])
        rectangle = add_element(add_element(element, "shape"), "rectangle")
        add_element(rectangle, "length", plain_decimal(float(log.sizes[row, 0])))
        add_element(rectangle, "width", plain_decimal(float(log.sizes[row, 1])))
        first = int(steps[0])
        _add_state(element, "initialState", log, row, 0 if is_static else first, source=first)
        if not is_static:
            trajectory = add_element(element, "trajectory")
            aside = np.array([_speeds(log, row, step)[1] for step in steps.tolist()])
            losses["sideways speeds of objects at their first step, left out"] += int(abs(aside[0]) > _SIDEWAYS)
            slides = bool((np.abs(aside[1:]) > _SIDEWAYS).any())  # all states of a trajectory have the same values
            for step in steps[1:].tolist():
                _add_state(trajectory, "state", log, row, step, source=step, slides=slides)
            if len(steps) == 1:  # the schema wants a state at a step above 0
                losses["objects observed at one step, written at the next one too"] += 1
                _add_state(trajectory, "state", log, row, first + 1, source=first)
    return number


def _add_state(
    parent: XmlElement, tag: str, log: Log, row: int, step: int, *, source: int, slides: bool = False
) -> None:
    """A state with the values of step ``source``, written as step ``step``.

    Args:
      slides: also write the speed to the left.
    """
    (x, y, _), heading = log.positions[row, source].tolist(), float(log.headings[row, source])
    ahead, aside = _speeds(log, row, source)
    state = add_element(parent, tag)
    add_point(add_element(state, "position"), x, y)
    _add_exact(state, "orientation", float(np.angle(np.exp(1j * heading))))
    add_element(add_element(state, "time"), "exact", str(step))
    if parent.tag == "staticObstacle":
        return
    _add_exact(state, "velocity", ahead)
    if slides:
        _add_exact(state, "velocityY", aside)
    if tag == "initialState":
        for name in ("acceleration", "yawRate", "slipAngle"):
            _add_exact(state, name, 0.0)


def _speeds(log: Log, row: int, step: int) -> tuple[float, float]:
    """Speed along the heading, and to the left of it [m/s]."""
    vx, vy = log.velocities[row, step].tolist()
    cos, sin = np.cos(log.headings[row, step]), np.sin(log.headings[row, step])
    return float(vx * cos + vy * sin), float(vy * cos - vx * sin)


def _add_exact(state: XmlElement, tag: str, value: float) -> None:
    add_element(add_element(state, tag), "exact", plain_decimal(float(value)))


def add_planning_problem(root: XmlElement, log: Log, number: int) -> None:
    """The ego's first state, and its last box with some margin as the goal."""
    row = log.ego_index
    steps = np.flatnonzero(log.valid[row])
    problem = add_element(root, "planningProblem", id=number)
    _add_state(problem, "initialState", log, row, int(steps[0]), source=int(steps[0]))
    goal = add_element(problem, "goalState")
    last = int(steps[-1])
    rectangle = add_element(add_element(goal, "position"), "rectangle")
    length, width, _ = (log.sizes[row] + 2 * _GOAL_MARGIN).tolist()
    for tag, value in (("length", length), ("width", width), ("orientation", log.headings[row, last])):
        add_element(rectangle, tag, plain_decimal(float(value)))
    center = add_element(rectangle, "center")
    for tag, value in zip("xy", log.positions[row, last].tolist(), strict=False):
        add_element(center, tag, plain_decimal(float(value)))
    time = add_element(goal, "time")
    add_element(time, "intervalStart", str(int(steps[0])))
    add_element(time, "intervalEnd", str(last))
