"""Edits of one scene by hand: agents are removed, inserted and moved. Everything else stays bit for bit.

Agent 0 is the ego. It is the frame of the scene, so it is neither removed nor moved. Results are NumPy scenes without
padding.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from scjax.scene.agent_sizes import CLASS_SIZES, CLASS_SPEEDS
from scjax.scene.arguments import finite_number, whole_number
from scjax.scene.boxes import overlaps
from scjax.scene.limits import MAX_SIZE, MAX_SPEED
from scjax.scene.scene import TILE_SIZE, AgentType, Crop, Scene, permute, unpadded

_AGENT_FIELDS = ("agents", "agent_types", "agent_mask", "agent_known")


def remove_agents(scene: Scene, agents: int | Iterable[int]) -> Scene:
    """``scene`` without some agents; the others keep their order.

    Args:
      scene: one scene.
      agents: indices, counted from 0 without padding.

    Raises:
      ValueError: there is no such agent, or it is the ego.
    """
    scene = single_scene(scene)
    rows = agent_rows(scene, agents)
    return permute(scene, np.delete(np.arange(len(scene.agents)), rows), np.arange(len(scene.lanes)))


def insert_agent(
    scene: Scene,
    agent_type: AgentType | str | int,
    x: float,
    y: float,
    heading: float = 0.0,
    *,
    speed: float | None = None,
    size: Sequence[float] | None = None,
) -> Scene:
    """``scene`` with one more agent, which is the last. It stands on the ground of the nearest lane.

    Args:
      scene: one scene with an ego.
      agent_type: ``AgentType``, or its name, as "vehicle".
      x, y, heading: of the center of its box, in the frame of the scene [m, rad].
      speed: [m/s]; by default usual for the class, and 0 for static objects.
      size: length, width, height [m]; by default the mean of the class.

    Raises:
      ValueError: the place is outside of the window or taken, or a value is out of range.
    """
    scene = single_scene(scene)
    kind = _agent_type(agent_type)
    if not len(scene.agents):
        raise ValueError("scene has no agents: agent 0 must be the ego, generate or crop a scene that has one")
    length, width, height = _size(CLASS_SIZES[kind] if size is None else size)
    x, y = _place(scene, x, y)
    speed = CLASS_SPEEDS[kind] if speed is None else finite_number(speed, "speed", 0.0, MAX_SPEED)
    angle = finite_number(heading, "heading")
    ground, is_known = _ground(scene, x, y)
    state = [x, y, ground + height / 2, speed, math.cos(angle), math.sin(angle), length, width, height]
    known = np.ones((1, len(state)), bool)
    known[0, 2] = is_known
    return _checked_place(
        scene.replace(
            agents=np.concatenate([scene.agents, np.array([state], scene.agents.dtype)]),
            agent_types=np.append(scene.agent_types, np.asarray(kind, scene.agent_types.dtype)),
            agent_mask=np.append(scene.agent_mask, True),
            agent_known=np.concatenate([scene.agent_known, known]),
        ),
        len(scene.agents),
    )


def move_agent(
    scene: Scene,
    agent: int,
    x: float | None = None,
    y: float | None = None,
    *,
    heading: float | None = None,
    speed: float | None = None,
) -> Scene:
    """``scene`` with one agent at another place, in another direction or at another speed; what is None stays.

    Args:
      scene: one scene.
      agent: index, counted from 0 without padding. Of agent 0, the ego, only the speed can change.
      x, y, heading, speed: as in ``insert_agent``. The height above the ground stays.

    Raises:
      ValueError: there is no such agent, the place is outside of the window or taken, or a value is out of range.
    """
    scene = single_scene(scene)
    row = whole_number(agent, "agent", 0, max(len(scene.agents) - 1, 0))
    is_placed = any(value is not None for value in (x, y, heading))
    if row == 0 and is_placed:
        raise ValueError(
            "agent 0 is the ego, the origin of the frame: it cannot move. Move the others, or cut a scene at another "
            "place with scjax.crop_map"
        )
    agents, known = np.array(scene.agents), np.array(scene.agent_known)
    state = agents[row]
    if x is not None or y is not None:
        before, _ = _ground(scene, float(state[0]), float(state[1]))
        place = _place(scene, state[0] if x is None else x, state[1] if y is None else y)
        state[:2] = place
        state[2] += _ground(scene, *place)[0] - before
    if heading is not None:
        angle = finite_number(heading, "heading")
        state[4:6] = math.cos(angle), math.sin(angle)
    if speed is not None:
        state[3], known[row, 3] = finite_number(speed, "speed", 0.0, MAX_SPEED), True
    edited = scene.replace(agents=agents, agent_known=known)
    return _checked_place(edited, row) if is_placed else edited


def single_scene(scene: Any) -> Scene:
    """One NumPy scene without padding.

    Raises:
      ValueError: it is no scene, or a batch.
    """
    if not isinstance(scene, Scene):
        raise ValueError(f"scene must be a scjax.Scene, not {type(scene).__name__}")
    if scene.batch_shape:
        raise ValueError(f"scene must be one scene, not a batch of shape {scene.batch_shape}: index it")
    return unpadded(scene.to_numpy())


def agent_rows(scene: Scene, agents: int | Iterable[int]) -> np.ndarray:
    """Sorted indices of agents other than the ego, each once [agents].

    Raises:
      ValueError: there is no such agent, or it is the ego.
    """
    most = len(scene.agents) - 1
    try:
        listed = [agents] if isinstance(agents, int | np.integer) else list(agents)
    except TypeError:
        raise ValueError(f"agents must be indices of agents, not {type(agents).__name__}") from None
    for agent in listed:
        if whole_number(agent, "agents: each index", 0, max(most, 0)) == 0:
            raise ValueError("agents: agent 0 is the ego, the frame of the scene: it stays, leave it out")
    return np.unique(np.array(listed, int))


def keep_elements(scene: Scene, agents: np.ndarray, lanes: np.ndarray) -> Scene:
    """``scene`` with only the agents and lanes that are True in two masks, in their order."""
    return permute(scene, np.flatnonzero(agents), np.flatnonzero(lanes))


def join_agents(scene: Scene, other: Scene, rows: Sequence[int] | np.ndarray) -> Scene:
    """``scene`` with some agents of another scene of the same frame after its own."""
    fields = {name: np.concatenate([getattr(scene, name), getattr(other, name)[rows]]) for name in _AGENT_FIELDS}
    return scene.replace(**fields)


def _agent_type(value: Any) -> AgentType:
    if isinstance(value, str) and value.upper() in AgentType.__members__:
        return AgentType[value.upper()]
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and value in tuple(AgentType):
        return AgentType(int(value))
    names = ", ".join(name.lower() for name in AgentType.__members__)
    raise ValueError(f"agent_type must be one of {names}, not {str(value)[:80]!r}")


def _size(value: Any) -> tuple[float, float, float]:
    try:
        length, width, height = value
    except (TypeError, ValueError):
        raise ValueError(f"size must be length, width and height in meters, not {str(value)[:80]!r}") from None
    length, width, height = (finite_number(one, "size: each number", 0.01, MAX_SIZE) for one in (length, width, height))
    return length, width, height


def _place(scene: Scene, x: Any, y: Any) -> tuple[float, float]:
    """The place, if it lies in the window of the scene."""
    half, shift = TILE_SIZE / 2, TILE_SIZE / 2 if scene.crop == Crop.FORWARD else 0.0
    return (
        finite_number(x, "x (the window of the scene)", shift - half, shift + half),
        finite_number(y, "y (the window of the scene)", -half, half),
    )


def _ground(scene: Scene, x: float, y: float) -> tuple[float, bool]:
    """z of the nearest lane point, and whether it is known; 0 without lanes."""
    if not len(scene.lanes):
        return 0.0, False
    squares = np.square(np.asarray(scene.lanes, np.float64)[..., :2] - np.array([x, y])).sum(-1)
    lane, point = np.unravel_index(squares.argmin(), squares.shape)
    return float(scene.lanes[lane, point, 2]), bool(scene.lane_known[lane, 2])


def _checked_place(scene: Scene, row: int) -> Scene:
    """The scene itself, if no other agent overlaps agent ``row``."""
    hit = np.flatnonzero(overlaps(np.asarray(scene.agents))[row])
    if len(hit):
        state = scene.agents[row]
        raise ValueError(
            f"x {state[0]:g}, y {state[1]:g} is taken: the box would overlap agent {hit[0]}. Choose another place, or "
            "remove that agent first"
        )
    return scene
