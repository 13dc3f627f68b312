"""Moves of agents that may show more of a request: one agent, or a few that make an event together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from scjax.language.analysis.lane_lines import LaneLines
from scjax.language.analysis.scene_analysis import Analysis
from scjax.scene import AgentType
from scjax.scene.angles import wrap_to_pi

Agents = Float64[np.ndarray, "agents 9"]

MOVABLE = {
    **dict.fromkeys(("ahead", "behind", "gap_ahead", "left_lane", "right_lane", "oncoming"), AgentType.VEHICLE),
    **dict.fromkeys(("crossing", "parked", "stopped", "queue"), AgentType.VEHICLE),
    **dict.fromkeys(("pedestrians_on_road", "pedestrians_ahead"), AgentType.PEDESTRIAN),
    "event": None,
}
"""Attributes that moves of agents change -> the class of these; None: it depends on the value."""

_WINDOW = 30.0  # m from the middle, where agents are put at most
_ONTO, _BESIDE = 0.4, (2.6, 3.6)  # m to the side of a lane: most of a vehicle on it, and of what stands beside
_WALKS = 1.4  # m from the middle of a lane, of people on the road at most
_SPEEDS = (3.0, 9.0)  # m/s
_QUEUE_GAP, _QUEUE_SIZE = (2.0, 5.0), 3  # m between bumpers, vehicles
_PULLED, _CORRIDOR_SPEED = (0.5, 0.8), 2.0  # m to the side, m/s
_CUT_OFFSET, _CUT_TURN, _CUT_GAP = (0.9, 1.3), np.deg2rad((4.0, 8.0)), (2.0, 8.0)  # m, rad, m
_NEXT_LANE = (2.4, 4.6)  # m
_NEAR_ROAD = 8.0  # m from the ego's way, where every second place lies
_JUNCTION = 6.0  # m around places where lanes cross or turn apart, where nothing is put if there are other places
_TRIES = 20


def draw_move(scene: Analysis, rng: np.random.Generator, lacking: Mapping[str, Any], fixed: int) -> Agents | None:
    """States after one random move that may help; None where this draw finds none.

    Args:
      lacking: attributes that do not hold -> what is requested; all are in ``MOVABLE``.
      fixed: so many leading agents stay.
    """
    name = str(rng.choice(list(lacking)))
    if name == "event":
        event = str(rng.choice(lacking["event"]))
        return _EVENTS[event](scene, rng, fixed) if event in _EVENTS else None
    if name == "queue":
        return _queue(scene, rng, fixed)
    agent = _pick(scene, rng, MOVABLE[name], fixed)
    if agent is None:
        return None
    if MOVABLE[name] == AgentType.PEDESTRIAN:
        return _walk(scene, rng, agent)
    if name == "stopped" and rng.random() < 0.7:
        states = scene.agents.copy()
        states[agent, 3] = 0.0 if states[agent, 3] > 0.5 else rng.uniform(*_SPEEDS)
        return states
    stands = name in ("parked", "stopped") and rng.random() < 0.6
    lateral = rng.choice([-1, 1]) * rng.uniform(*_BESIDE) if stands else rng.uniform(-_ONTO, _ONTO)
    speed = 0.0 if stands else max(scene.agents[agent, 3], _SPEEDS[0])
    return _put(scene, agent, _place(scene, rng), lateral, speed)


def _pick(scene: Analysis, rng: np.random.Generator, type_: AgentType, fixed: int) -> int | None:
    """One agent of a class that may move; None without any."""
    rows = _pick_several(scene, rng, type_, fixed, 1)
    return None if rows is None else rows[0]


def _pick_several(
    scene: Analysis, rng: np.random.Generator, type_: AgentType, fixed: int, number: int
) -> list[int] | None:
    """Agents of a class that may move; None without so many."""
    rows = np.flatnonzero(scene.is_type(type_) & (np.arange(len(scene.types)) >= fixed))
    return None if len(rows) < number else rng.permutation(rows)[:number].tolist()


def _place(scene: Analysis, rng: np.random.Generator) -> tuple[int, int]:
    """A lane and one of its points outside junctions, every second one near the ego's way."""
    lines = scene.lines
    near_road = scene.route is not None and rng.random() < 0.5
    for _ in range(_TRIES):
        lane = int(rng.integers(len(lines)))
        point = int(rng.integers(max(1, lines.count[lane])))
        if near_road:
            lane, point = _beside_way(scene, rng)
        place = lines.points[lane, point, :2]
        if np.abs(place).max() < _WINDOW and scene.junction_distance(place[None])[0] > _JUNCTION:
            break
    return lane, point


def _beside_way(scene: Analysis, rng: np.random.Generator) -> tuple[int, int]:
    """A point of a lane within 8 m of a random point of the ego's way."""
    lines, route = scene.lines, scene.route
    assert route is not None
    offset = lines.points[..., :2] - route.points[int(rng.integers(len(route.points))), :2]
    near = np.argwhere((np.hypot(offset[..., 0], offset[..., 1]) < _NEAR_ROAD) & lines.real)
    lane, point = near[int(rng.integers(len(near)))]
    return int(lane), int(point)


def _put(
    scene: Analysis, agent: int, place: tuple[int, int], lateral: float, speed: float, turn: float = 0.0
) -> Agents:
    """States with one agent on a lane, ``lateral`` m to its left, turned by ``turn`` to the left."""
    states = scene.agents.copy()
    _set(states, scene.lines, agent, place, lateral, speed, turn)
    return states


def _set(
    states: Agents,
    lines: LaneLines,
    agent: int,
    place: tuple[int, int],
    lateral: float,
    speed: float,
    turn: float = 0.0,
) -> None:
    """As ``_put``, in place; the agent stands on the ground of the lane."""
    x, y, z = lines.points[place]
    heading = lines.headings[place]
    yaw = heading + turn
    states[agent, :3] = x - np.sin(heading) * lateral, y + np.cos(heading) * lateral, z + states[agent, 8] / 2
    states[agent, 3:6] = speed, np.cos(yaw), np.sin(yaw)


def _back(scene: Analysis, place: tuple[int, int], distance: float) -> tuple[int, int] | None:
    """The point of the same lane so far behind; None where the lane begins later."""
    lane, point = place
    point -= round(distance / float(scene.lines.spacing[lane]))
    return (lane, point) if point >= 0 else None


def _walk(scene: Analysis, rng: np.random.Generator, agent: int) -> Agents:
    """A person onto the road, or beside it."""
    lateral = rng.uniform(-_WALKS, _WALKS) if rng.random() < 0.5 else rng.choice([-1, 1]) * rng.uniform(2.2, 6.0)
    turn = rng.choice([-1, 1]) * np.pi / 2 if abs(lateral) < _WALKS else 0.0
    return _put(scene, agent, _place(scene, rng), lateral, scene.agents[agent, 3], turn)


def _queue(scene: Analysis, rng: np.random.Generator, fixed: int) -> Agents | None:
    """Three vehicles behind each other on one lane, standing."""
    rows = _pick_several(scene, rng, AgentType.VEHICLE, fixed, _QUEUE_SIZE)
    if rows is None:
        return None
    states, place = scene.agents.copy(), _place(scene, rng)
    last = None
    for agent in rows:
        if last is not None:
            reach = (states[agent, 6] + states[last, 6]) / 2 + rng.uniform(*_QUEUE_GAP)
            behind = _back(scene, place, reach)
            if behind is None:
                return None
            place = behind
        _set(states, scene.lines, int(agent), place, 0.0, 0.0)
        last = agent
    return states


def _jaywalker(scene: Analysis, rng: np.random.Generator, fixed: int) -> Agents | None:
    agent = _pick(scene, rng, AgentType.PEDESTRIAN, fixed)
    if agent is None:
        return None
    turn = rng.choice([-1, 1]) * np.pi / 2
    return _put(scene, agent, _place(scene, rng), rng.uniform(-_WALKS, _WALKS), 1.2, turn)


def _wrong_way(scene: Analysis, rng: np.random.Generator, fixed: int) -> Agents | None:
    agent = _pick(scene, rng, AgentType.VEHICLE, fixed)
    speed = rng.uniform(*_SPEEDS)
    return None if agent is None else _put(scene, agent, _place(scene, rng), rng.uniform(-_ONTO, _ONTO), speed, np.pi)


def _stopped_in_lane(scene: Analysis, rng: np.random.Generator, fixed: int) -> Agents | None:
    agent = _pick(scene, rng, AgentType.VEHICLE, fixed)
    return None if agent is None else _put(scene, agent, _place(scene, rng), rng.uniform(-_ONTO, _ONTO), 0.0)


def _double_parking(scene: Analysis, rng: np.random.Generator, fixed: int) -> Agents | None:
    """One vehicle stands in a lane, one parks beside it."""
    rows = _pick_several(scene, rng, AgentType.VEHICLE, fixed, 2)
    if rows is None:
        return None
    place, side = _place(scene, rng), rng.choice([-1, 1])
    states = _put(scene, int(rows[0]), place, side * 0.4, 0.0)
    _set(states, scene.lines, int(rows[1]), place, side * rng.uniform(2.9, 3.4), 0.0)
    return states


def _beside_lane(scene: Analysis, place: tuple[int, int]) -> tuple[tuple[int, int], float] | None:
    """The point of a parallel lane beside, and how far it lies to the left [m]; None without one."""
    lines, (lane, point) = scene.lines, place
    offset = lines.points[..., :2] - lines.points[lane, point, :2]
    heading = lines.headings[lane, point]
    ahead = np.cos(heading) * offset[..., 0] + np.sin(heading) * offset[..., 1]
    left = np.cos(heading) * offset[..., 1] - np.sin(heading) * offset[..., 0]
    parallel = np.abs(wrap_to_pi(lines.headings - heading)) < 0.15
    beside = (np.abs(ahead) < 1.0) & (np.abs(left) > _NEXT_LANE[0]) & (np.abs(left) < _NEXT_LANE[1])
    found = np.argwhere(beside & parallel & lines.real)
    if not len(found):
        return None
    other = int(found[0, 0]), int(found[0, 1])
    return other, float(left[other])


def _cut_in(scene: Analysis, rng: np.random.Generator, fixed: int) -> Agents | None:
    """A vehicle between two lanes turns into one where another one, or the ego, follows."""
    rows = _pick_several(scene, rng, AgentType.VEHICLE, fixed, 2)
    single = _pick(scene, rng, AgentType.VEHICLE, fixed)
    if single is None:
        return None
    of_ego = rows is None or (scene.route is not None and scene.speeds[0] > 1.0 and rng.random() < 0.5)
    if of_ego:
        if scene.route is None:
            return None
        agents, place = [single], (scene.route.lane, scene.route.point)
        ahead = (scene.agents[single, 6] + scene.ego[6]) / 2 + rng.uniform(*_CUT_GAP)
        point = place[1] + round(ahead / float(scene.lines.spacing[place[0]]))
        if point >= scene.lines.count[place[0]]:
            return None
        place = place[0], point
    else:
        assert rows is not None
        agents, place = [int(row) for row in rows], _place(scene, rng)
    beside = _beside_lane(scene, place)
    if beside is None:
        return None
    side = np.sign(beside[1])
    speed = max(float(scene.speeds[0]) if of_ego else 0.0, rng.uniform(*_SPEEDS))
    states = _put(scene, agents[0], place, side * rng.uniform(*_CUT_OFFSET), speed, -side * rng.uniform(*_CUT_TURN))
    if not of_ego:
        reach = (states[agents[0], 6] + states[agents[1], 6]) / 2 + rng.uniform(*_CUT_GAP)
        behind = _back(scene, place, reach)
        if behind is None:
            return None
        _set(states, scene.lines, agents[1], behind, 0.0, speed)
    return states


def _corridor(scene: Analysis, rng: np.random.Generator, fixed: int) -> Agents | None:
    """Two slow vehicles pull to the left on one lane, two to the right on the lane to its right."""
    rows = _pick_several(scene, rng, AgentType.VEHICLE, fixed, 4)
    if rows is None:
        return None
    place = _place(scene, rng)
    beside = _beside_lane(scene, place)
    if beside is None:
        return None
    left, right = (place, beside[0]) if beside[1] < 0 else (beside[0], place)
    states = scene.agents.copy()
    for (front, rear), start, side in ((rows[:2], left, 1), (rows[2:], right, -1)):
        reach = (states[front, 6] + states[rear, 6]) / 2 + rng.uniform(*_QUEUE_GAP)
        behind = _back(scene, start, reach)
        if behind is None:
            return None
        for agent, where in ((front, start), (rear, behind)):
            _set(states, scene.lines, int(agent), where, side * rng.uniform(*_PULLED), _CORRIDOR_SPEED)
    return states


_EVENTS: dict[str, Callable[[Analysis, np.random.Generator, int], Agents | None]] = {
    "wrong-way": _wrong_way,
    "jaywalker": _jaywalker,
    "stopped-in-lane": _stopped_in_lane,
    "double-parking": _double_parking,
    "emergency-corridor": _corridor,
    "cut-in": _cut_in,
}
