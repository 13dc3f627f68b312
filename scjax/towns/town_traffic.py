"""Traffic in a town: every track of one simulation, and the signals, as arrays in a file."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene.files import write_file
from scjax.scene.npz import read_npz
from scjax.towns.tracks import Track

TRAFFIC_VERSION = 5  # raise it when the same simulation would give other arrays
_KINDS = {
    "types": "i",
    "sizes": "f",
    "starts": "i",
    "offsets": "i",
    "positions": "f",
    "headings": "f",
    "signal_states": "i",
    "names": "U",
    "signal_lanes": "U",
    "egos": "i",
}


@dataclasses.dataclass(frozen=True)
class TownTraffic:
    """Tracks of N objects; that of object k is ``positions[offsets[k]:offsets[k + 1]]``, from step ``starts[k]`` on.

    Attributes:
      names: of the objects.
      types: ``AgentType``.
      sizes: length, width, height [m].
      starts: first step of each.
      offsets: where the track of each begins.
      positions: centers of boxes [m].
      headings: [rad].
      signal_lanes: ids of the lanes that signals control.
      signal_states: ``Signal`` of each at every step.
      egos: (step, object): moments at which a log is cut around an object.
    """

    names: tuple[str, ...]
    types: Int[np.ndarray, " N"]
    sizes: Float64[np.ndarray, "N 3"]
    starts: Int[np.ndarray, " N"]
    offsets: Int[np.ndarray, " offsets"]
    positions: Float64[np.ndarray, "points 3"]
    headings: Float64[np.ndarray, " points"]
    signal_lanes: tuple[str, ...]
    signal_states: Int[np.ndarray, "S T"]
    egos: Int[np.ndarray, "egos 2"]

    @property
    def num_steps(self) -> int:
        """T, the number of steps."""
        return self.signal_states.shape[1]

    @property
    def ends(self) -> Int[np.ndarray, " N"]:
        """The step behind the last one of each object."""
        return self.starts + np.diff(self.offsets)

    def objects_between(self, first: int, last: int) -> Int[np.ndarray, " objects"]:
        """Objects that are there at some step from ``first`` to before ``last``."""
        return np.flatnonzero((self.starts < last) & (self.ends > first))

    def rows_at(self, objects: Int[np.ndarray, " objects"], step: int) -> Int[np.ndarray, " objects"]:
        """Rows of ``positions`` of objects at a step; -1 where an object is not there."""
        there = (self.starts[objects] <= step) & (step < self.ends[objects])
        return np.where(there, self.offsets[objects] + step - self.starts[objects], -1)


def collect_traffic(
    tracks: Sequence[Track], signal_lanes: Sequence[str], signal_states: Int[np.ndarray, "S T"]
) -> TownTraffic:
    """The arrays of tracks, cut to the steps of the signals."""
    steps = signal_states.shape[1]
    kept = [track for track in tracks if track.start < steps and track.start + len(track.positions) > 0]
    spans = [(max(-track.start, 0), min(steps - track.start, len(track.positions))) for track in kept]
    positions = [track.positions[low:high] for track, (low, high) in zip(kept, spans, strict=True)]
    headings = [track.headings[low:high] for track, (low, high) in zip(kept, spans, strict=True)]
    return TownTraffic(
        names=tuple(track.name for track in kept),
        types=np.array([int(track.agent_type) for track in kept], np.int64),
        sizes=np.array([track.size for track in kept], np.float64).reshape(-1, 3),
        starts=np.array([max(track.start, 0) for track in kept], np.int64),
        offsets=np.cumsum([0, *(len(part) for part in positions)]),
        positions=np.concatenate([np.zeros((0, 3)), *positions]),
        headings=np.concatenate([np.zeros(0), *headings]),
        signal_lanes=tuple(signal_lanes),
        signal_states=signal_states,
        egos=np.zeros((0, 2), np.int64),
    )


def save_traffic(traffic: TownTraffic, path: Path) -> None:
    """Writes traffic to a file; positions with a resolution of about a millimeter."""
    arrays = {field.name: np.array(getattr(traffic, field.name)) for field in dataclasses.fields(traffic)}
    arrays["positions"] = np.round(arrays["positions"] * 1000).astype(np.int32)
    arrays["headings"] = arrays["headings"].astype(np.float32)
    arrays |= {name: np.array(getattr(traffic, name), np.str_) for name in ("names", "signal_lanes")}  # also if empty
    header = json.dumps({"version": TRAFFIC_VERSION})
    write_file(path, lambda file: np.savez_compressed(file, allow_pickle=False, header=header, **arrays))


def load_traffic(path: Path) -> TownTraffic:
    """Reads what ``save_traffic`` wrote.

    Raises:
      FileNotFoundError: if there is no such file.
      ValueError: the file is damaged or of another version; names it.
    """
    arrays = read_npz(path, {"header": "U", **_KINDS, "positions": "i"}, "make the traffic again")
    if json.loads(str(arrays.pop("header"))).get("version") != TRAFFIC_VERSION:
        raise ValueError(f"{path} has another version than this scjax writes: make the traffic again")
    arrays["positions"] = arrays["positions"] / 1000.0
    arrays["headings"] = arrays["headings"].astype(np.float64)
    names, lanes = (tuple(map(str, arrays.pop(name))) for name in ("names", "signal_lanes"))
    return TownTraffic(names=names, signal_lanes=lanes, **arrays)
