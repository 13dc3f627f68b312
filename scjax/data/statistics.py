"""Statistics of a set of scenes: streamed sums per column of agents and lanes."""

from __future__ import annotations

from typing import Any

import numpy as np

from scjax.scene import STATE_COLUMNS, AgentType, Scene

_LANE_COLUMNS = ("x", "y", "z")


class SceneStatistics:
    """Count, sum, sum of squares, minimum and maximum of all known values, by column of each agent type and of lanes.

    ``state`` is JSON-serializable; ``merge`` adds the states of disjoint sets of scenes.
    """

    def __init__(self) -> None:
        self.state: dict[str, Any] = {"agents": {agent_type.name.lower(): {} for agent_type in AgentType}, "lanes": {}}

    def add(self, scene: Scene) -> None:
        """Adds one scene."""
        scene = scene.to_numpy()
        agents, lanes = np.asarray(scene.agents), np.asarray(scene.lanes)
        for agent_type in AgentType:
            rows = scene.agent_mask & (scene.agent_types == agent_type)
            table = self.state["agents"][agent_type.name.lower()]
            for column, name in enumerate(STATE_COLUMNS):
                known = rows & scene.agent_known[:, column]
                _accumulate(table, name, _sums(agents[known, column]))
        for column, name in enumerate(_LANE_COLUMNS):
            known = scene.lane_mask & scene.lane_known[:, column]
            _accumulate(self.state["lanes"], name, _sums(lanes[known][..., column]))

    def merge(self, state: dict[str, Any]) -> None:
        """Adds the ``state`` of another set of scenes."""
        for agent_type, table in state["agents"].items():
            for name, sums in table.items():
                _accumulate(self.state["agents"][agent_type], name, sums)
        for name, sums in state["lanes"].items():
            _accumulate(self.state["lanes"], name, sums)

    def summary(self) -> dict[str, Any]:
        """Count, mean, standard deviation, minimum and maximum of every column that has values."""
        agents = {agent_type: _summary(table) for agent_type, table in self.state["agents"].items() if table}
        return {"agents": agents, "lanes": _summary(self.state["lanes"])}


def _sums(values: np.ndarray) -> list[float]:
    if not values.size:
        return []
    values = values.astype(np.float64)
    return [float(values.size), float(values.sum()), float((values**2).sum()), float(values.min()), float(values.max())]


def _accumulate(table: dict[str, list[float]], name: str, sums: list[float]) -> None:
    if not sums:
        return
    if name not in table:
        table[name] = list(sums)
        return
    count, total, squares, low, high = table[name]
    table[name] = [count + sums[0], total + sums[1], squares + sums[2], min(low, sums[3]), max(high, sums[4])]


def _summary(table: dict[str, list[float]]) -> dict[str, dict[str, Any]]:
    summary = {}
    for name, (count, total, squares, low, high) in table.items():
        mean = total / count
        std = max(squares / count - mean * mean, 0.0) ** 0.5
        summary[name] = {"count": int(count), "mean": mean, "std": std, "min": low, "max": high}
    return summary
