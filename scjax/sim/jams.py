"""Vehicles that keep a junction closed for good; NumPy on the host."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import AgentType
from scjax.sim.agents import Agents, agent_columns
from scjax.sim.places import place_agents
from scjax.sim.preparation import Start
from scjax.sim.road_network import NONE

_SECONDS = 60.0  # longer than any phase of a signal
_MOVES = 3.0  # m; who gets farther than this has moved
_PAUSE = 10.0  # s, in which others may move off


class JamWatch:
    """Finds vehicles that have hardly moved for a minute while they stand where lanes cross or merge.

    Such vehicles are in each other's way, and nobody gets on any more. Traffic simulators take them out of the jam
    (``time-to-teleport`` of SUMO).
    """

    def __init__(self):
        self._rests: dict[str, tuple[Float64[np.ndarray, " 2"], float]] = {}
        self._next = 0.0

    def blocking_row(self, start: Start, agents: Agents, clock: float, driven: int) -> int | None:
        """The row of the vehicle that has stood in a junction for longest; None without a jam.

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
        rows = rows[np.asarray(agents.kind)[rows] == AgentType.VEHICLE]
        rows = rows[_in_junctions(start, agents, rows)]
        if not len(rows):
            return None
        self._next = clock + _PAUSE
        return min(rows.tolist(), key=since.__getitem__)


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
