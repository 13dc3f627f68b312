"""Vehicles that keep a junction or a lane closed for good; NumPy on the host."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import AgentType
from scjax.sim.agents import Agents, agent_columns
from scjax.sim.places import place_agents
from scjax.sim.preparation import Start
from scjax.sim.road_network import NONE

_SECONDS = 40.0  # no signal is red for more than 32 s
_MOVES = 3.0  # m; who gets farther than this has moved
_PAUSE = 10.0  # s, in which others may move off
_QUEUE_GAP, _QUEUE_WIDTH = 8.0, 3.0  # m before a vehicle, and across, where the next one of its queue stands


class JamWatch:
    """Finds vehicles and cyclists that have hardly moved for 40 s and are in the way of others.

    They stand where lanes cross or merge, or are the first of a queue; no signal is red for so long. Nobody gets on any
    more. Traffic simulators take such vehicles out of the jam (``time-to-teleport`` of SUMO).
    """

    def __init__(self):
        self._rests: dict[str, tuple[Float64[np.ndarray, " 2"], float]] = {}
        self._next = 0.0

    def blocking_row(self, start: Start, agents: Agents, clock: float, driven: int) -> int | None:
        """The row of the agent that has stood for longest, in a junction if there is one; None without a jam.

        Parked ones do not count.

        Args:
          agents: of the network of ``start``, as they are now.
          clock: time [s]; calls follow each other by a few seconds.
          driven: row that is never meant.
        """
        ids = start.log.object_ids
        places = np.stack([agents.x, agents.y], -1).astype(np.float64)[: len(ids)] + start.origin[:2]
        rests = {}
        for row in np.flatnonzero(np.asarray(agents.valid)[: len(ids)]):
            place, first = self._rests.get(ids[row], (places[row], clock))
            moved = np.hypot(*(places[row] - place)) > _MOVES
            rests[ids[row]] = (places[row], clock) if moved else (place, first)
        self._rests = rests
        if clock < self._next:
            return None
        since = {row: rests[name][1] for row, name in enumerate(ids) if name in rests and row != driven}
        rows = np.array([row for row, first in since.items() if clock - first >= _SECONDS], int)
        rows = rows[np.isin(np.asarray(agents.kind)[rows], (AgentType.VEHICLE, AgentType.CYCLIST))]
        blocking = rows[_in_junctions(start, agents, rows)]
        if not len(blocking):
            blocking = rows[_first_of_queues(start, agents, rows)]
        if not len(blocking):
            return None
        self._next = clock + _PAUSE
        return min(blocking.tolist(), key=since.__getitem__)


def _in_junctions(start: Start, agents: Agents, rows: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which of the vehicles stand on a part of their lane where they are in the way of another lane."""
    states = agent_columns(agents, rows)
    places = place_agents(start.lanes, states, np.asarray(agents.kind)[rows])
    network, out = start.network, np.zeros(len(rows), bool)
    for number, lane in enumerate(np.asarray(places.lane)):
        if lane == NONE:
            continue
        conflicts = np.asarray(network.conflicts)[lane]
        conflicts = conflicts[conflicts >= 0]
        along, half = float(np.asarray(places.along)[number]), states[number, 6] / 2
        begin, end = (np.asarray(edge)[conflicts] for edge in (network.conflict_start, network.conflict_end))
        out[number] = ((begin < along + half) & (end > along - half)).any()
    return out


def _first_of_queues(start: Start, agents: Agents, rows: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which of the agents follow a lane, and stand behind nobody who does so in their direction."""
    follows = np.asarray(start.places.lane) != NONE
    others = np.flatnonzero(follows & np.asarray(agents.valid))
    mine, states = agent_columns(agents, rows)[:, None], agent_columns(agents, others)[None]
    x, y = np.moveaxis(states[..., :2] - mine[..., :2], -1, 0)
    ahead, side = x * mine[..., 4] + y * mine[..., 5], y * mine[..., 4] - x * mine[..., 5]
    gap = ahead - (mine[..., 6] + states[..., 6]) / 2
    behind = (ahead > 0) & (gap < _QUEUE_GAP) & (np.abs(side) < _QUEUE_WIDTH / 2)
    behind &= (states[..., 4:6] * mine[..., 4:6]).sum(-1) > 0
    return follows[rows] & ~behind.any(1)
