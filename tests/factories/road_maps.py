"""Small maps with traffic for roll-outs: a straight road, a crossing with signals, a fork."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.scene import AgentType, Map, Signal
from tests.factories.maps import map_lane

CAR = (4.5, 2.0, 1.6)


def agent(x: float, y: float, degrees: float = 0.0, speed: float = 0.0, size: Sequence[float] = CAR) -> np.ndarray:
    """Columns of ``Scene.agents`` [9]."""
    angle = np.deg2rad(degrees)
    return np.array([x, y, size[2] / 2, speed, np.cos(angle), np.sin(angle), *size])


def with_agents(lanes: Sequence, agents: Sequence[np.ndarray], types: Sequence[int] | None = None, **fields) -> Map:
    """A map with these agents, vehicles by default."""
    kinds = [AgentType.VEHICLE] * len(agents) if types is None else list(types)
    return Map(
        lanes=tuple(lanes),
        agent_ids=tuple(f"a{row}" for row in range(len(agents))),
        agent_types=np.array(kinds, np.int32),
        agents=np.array(agents).reshape(len(agents), 9),
        **fields,
    )


def road(length: float = 400.0, y: float = 0.0, name: str = "road", **links):
    """A straight lane in the direction of +x."""
    return map_lane(name, (0.0, y, 0.0), (length, y, 0.0), **links)


def signaled_road(state: Signal, agents: Sequence[np.ndarray], stop: float = 100.0) -> Map:
    """A straight road with a signal at x = ``stop``, and a road across whose signal shows GO where it shows STOP."""
    lanes = (
        map_lane("in", (0.0, 0.0, 0.0), (stop, 0.0, 0.0), successors=("out",)),
        map_lane("out", (stop, 0.0, 0.0), (stop + 200.0, 0.0, 0.0), predecessors=("in",)),
        map_lane("across", (stop + 12.0, -12.0, 0.0), (stop + 12.0, 60.0, 0.0)),
    )
    other = {Signal.STOP: Signal.GO, Signal.GO: Signal.STOP}.get(state, state)
    return with_agents(
        lanes,
        agents,
        signal_lane_ids=("out", "across"),
        signal_states=np.array([state, other], np.int32),
        signal_positions=np.array([[stop, 0.0, 0.0], [stop + 12.0, -12.0, 0.0]]),
    )


def crossing(agents: Sequence[np.ndarray]) -> Map:
    """Two straight roads that cross at (100, 0), without signals."""
    lanes = (
        map_lane("east", (0.0, 0.0, 0.0), (200.0, 0.0, 0.0)),
        map_lane("north", (100.0, -100.0, 0.0), (100.0, 100.0, 0.0)),
    )
    return with_agents(lanes, agents)


def merge(agents: Sequence[np.ndarray]) -> Map:
    """A straight road that another one joins at an angle at (100, 0)."""
    lanes = (
        map_lane("main", (0.0, 0.0, 0.0), (100.0, 0.0, 0.0), successors=("after",)),
        map_lane("ramp", (0.0, -30.0, 0.0), (100.0, 0.0, 0.0), successors=("after",)),
        map_lane("after", (100.0, 0.0, 0.0), (300.0, 0.0, 0.0), predecessors=("main", "ramp")),
    )
    return with_agents(lanes, agents)
