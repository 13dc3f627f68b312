"""Tracks of a simulation -> a ``Log``: every vehicle that enters the map is an object of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import NO_EGO, Log
from scjax.sim.agents import Agents
from scjax.sim.preparation import Start

_FIELDS = ("x", "y", "z", "heading", "speed")


@dataclasses.dataclass
class _Track:
    """One object: its type, size, and x, y, z, heading, speed at the steps where it is there."""

    kind: int
    size: np.ndarray
    steps: list[np.ndarray]
    values: list[np.ndarray]


class TrackLog:
    """Collects what happened, network by network; step 0 is the moment of the first start."""

    def __init__(self, start: Start):
        self.num_steps = 1
        self._tracks: dict[str, _Track] = {}
        self._signals: dict[str, list[np.ndarray]] = {}
        self._names: dict[tuple[int, int], str] = {}
        self._start: Start | None = None
        self._begin(start)
        first = {name: np.asarray(getattr(start.agents, name))[None] for name in (*_FIELDS, "valid", "entries")}
        self._collect(first, np.zeros(1, int))
        self._show(start, start.plan.states(np.zeros(1)), 0)

    def add(self, start: Start, after: dict[str, np.ndarray], signals: Int[np.ndarray, "S T"]) -> None:
        """Adds T steps.

        Args:
          start: of the present network; its agents are rows of ``after``.
          after: arrays [T, N] of x, y, z, heading, speed, valid and entries.
          signals: states of the start's signals at these steps.
        """
        if start is not self._start:
            self._begin(start)
        steps = len(after["x"])
        self._collect(after, np.arange(self.num_steps, self.num_steps + steps))
        self._show(start, signals, self.num_steps)
        self.num_steps += steps

    def present(
        self, start: Start, agents: Agents
    ) -> tuple[tuple[str, ...], Float64[np.ndarray, "n 9"], Int[np.ndarray, " n"]]:
        """Ids, columns of ``Scene.agents`` in the frame of the log, and types of the agents that are there."""
        if start is not self._start:
            self._begin(start)
        rows = np.flatnonzero(np.asarray(agents.valid)[: start.log.num_objects])
        entries = np.asarray(agents.entries)
        names = tuple(self._name(int(row), int(entries[row])) for row in rows)
        heading = np.asarray(agents.heading, np.float64)[rows]
        place = np.stack([np.asarray(getattr(agents, axis), np.float64)[rows] for axis in "xyz"], -1) + start.origin
        place[np.isnan(start.log.positions[rows, 0, 2]), 2] = np.nan
        states = np.concatenate(
            [
                place,
                np.asarray(agents.speed, np.float64)[rows, None],
                np.stack([np.cos(heading), np.sin(heading)], -1),
                start.log.sizes[rows],
            ],
            axis=1,
        )
        return names, states, start.log.object_types[rows]

    def log(self, base: Log, ego: str | None, dt: float) -> Log:
        """All of it, with lanes and metadata of ``base``, whose other fields do not count.

        Args:
          ego: id of the object that is the ego.
        """
        names = tuple(self._tracks)
        shape = (len(names), self.num_steps)
        values, valid = np.zeros((*shape, len(_FIELDS))), np.zeros(shape, bool)
        for row, track in enumerate(self._tracks.values()):
            at = np.concatenate(track.steps)
            values[row, at], valid[row, at] = np.concatenate(track.values), True
        heading, speed = values[..., 3], values[..., 4]
        signals = {name: _joined(parts, self.num_steps) for name, parts in self._signals.items()}
        known = {lane_id: place for lane_id, place in zip(base.signal_lane_ids, base.signal_positions, strict=True)}
        ids = [name for name in signals if name in known]
        states = np.array([signals[name] for name in ids], np.int32).reshape(len(ids), self.num_steps)
        return dataclasses.replace(
            base,
            timestamps=np.arange(self.num_steps) * dt,
            object_ids=names,
            object_types=np.array([track.kind for track in self._tracks.values()], np.int32),
            valid=valid,
            positions=values[..., :3],
            headings=heading,
            velocities=speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], -1),
            sizes=np.array([track.size for track in self._tracks.values()]).reshape(len(names), 3),
            ego_index=NO_EGO if ego is None else names.index(ego),
            signal_lane_ids=tuple(ids),
            signal_states=states,
            signal_positions=np.array([known[name] for name in ids]).reshape(len(ids), 3),
        )

    def _begin(self, start: Start) -> None:
        self._start = start
        self._names = {(row, 0): name for row, name in enumerate(start.log.object_ids)}

    def _name(self, row: int, entry: int) -> str:
        """Id of the object in a row after it has been given away ``entry`` times."""
        if (row, entry) not in self._names:
            base, number = self._names[row, 0], entry
            while f"{base}.{number}" in self._tracks:
                number += 1
            self._names[row, entry] = f"{base}.{number}"
        return self._names[row, entry]

    def _collect(self, after: dict[str, np.ndarray], steps: np.ndarray) -> None:
        assert self._start is not None
        log, origin = self._start.log, self._start.origin
        table = np.stack([after[name].astype(np.float64) for name in _FIELDS], -1)  # [T, N, 5]
        table[..., :3] += origin
        for row in range(log.num_objects):
            if np.isnan(log.positions[row, 0, 2]):
                table[:, row, 2] = np.nan
            for entry in np.unique(after["entries"][:, row]).tolist():
                here = after["valid"][:, row] & (after["entries"][:, row] == entry)
                if not here.any():
                    continue
                name = self._name(row, entry)
                if name not in self._tracks:
                    self._tracks[name] = _Track(int(log.object_types[row]), log.sizes[row], [], [])
                self._tracks[name].steps.append(steps[here])
                self._tracks[name].values.append(table[here, row])

    def _show(self, start: Start, signals: np.ndarray, first: int) -> None:
        for lane_id, states in zip(start.log.signal_lane_ids, signals, strict=True):
            parts = self._signals.setdefault(lane_id, [])
            missing = first - sum(len(part) for part in parts)
            parts.append(np.concatenate([np.zeros(missing, int), states]))


def _joined(parts: list[np.ndarray], steps: int) -> np.ndarray:
    """States over all steps; UNKNOWN where a signal was not there."""
    states = np.concatenate(parts)
    return np.concatenate([states, np.zeros(steps - len(states), int)])
