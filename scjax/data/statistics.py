"""What a set of scenes looks like in numbers: streamed sums per column, and how many lanes and agents scenes have."""

from __future__ import annotations

from typing import Any

import numpy as np

from scjax.scene import STATE_COLUMNS, AgentType, Scene

_LANE_COLUMNS = ("x", "y", "z")


class SceneStatistics:
    """Count, sum, sum of squares, minimum and maximum of every known value, by agent class and column, and lane column.

    ``state`` is JSON-serialisable; states of disjoint sets of scenes add up through ``merge``.
    """

    def __init__(self) -> None:
        self.state: dict[str, Any] = {"agents": {kind.name.lower(): {} for kind in AgentType}, "lanes": {}}

    def add(self, scene: Scene) -> None:
        """Takes in one scene."""
        scene = scene.to_numpy()
        agents, lanes = np.asarray(scene.agents), np.asarray(scene.lanes)
        for kind in AgentType:
            rows = scene.agent_mask & (scene.agent_types == kind)
            table = self.state["agents"][kind.name.lower()]
            for column, name in enumerate(STATE_COLUMNS):
                known = rows & scene.agent_known[:, column]
                _accumulate(table, name, _sums(agents[known, column]))
        for column, name in enumerate(_LANE_COLUMNS):
            known = scene.lane_mask & scene.lane_known[:, column]
            _accumulate(self.state["lanes"], name, _sums(lanes[known][..., column]))

    def merge(self, state: dict[str, Any]) -> None:
        """Takes in the ``state`` of another set of scenes."""
        for kind, table in state["agents"].items():
            for name, sums in table.items():
                _accumulate(self.state["agents"][kind], name, sums)
        for name, sums in state["lanes"].items():
            _accumulate(self.state["lanes"], name, sums)

    def summary(self) -> dict[str, Any]:
        """Count, mean, standard deviation, minimum and maximum of every column that has values."""
        agents = {kind: _summary(table) for kind, table in self.state["agents"].items() if table}
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
    old = table[name]
    table[name] = [old[0] + sums[0], old[1] + sums[1], old[2] + sums[2], min(old[3], sums[3]), max(old[4], sums[4])]


def _summary(table: dict[str, list[float]]) -> dict[str, dict[str, Any]]:
    out = {}
    for name, (count, total, squares, low, high) in table.items():
        mean = total / count
        std = max(squares / count - mean * mean, 0.0) ** 0.5
        out[name] = {"count": int(count), "mean": mean, "std": std, "min": low, "max": high}
    return out
