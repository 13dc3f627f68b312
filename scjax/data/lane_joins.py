"""Which lanes follow each other: one judge of gap, turn and height for recorded and inferred connections."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.data.join_options import JOIN_DISTANCE, MAX_JOIN_DISTANCE, JoinOptions
from scjax.scene import MapLane

MAX_TURN = np.deg2rad(120.0)  # at a joint; no car can drive more
SAME_HEADING = np.deg2rad(30.0)  # of an end and a start that are apart, but meant to meet
MAX_STEP = 1.0  # m in height

Pairs = set[tuple[int, int]]


class Joins(NamedTuple):
    """Connections of lanes, and what to report of the source.

    Attributes:
      pairs: (i, j), lane j follows lane i.
      warnings: what is wrong in the source -> how often; those connections are refused.
      notes: what a user may want to know -> how often.
    """

    pairs: Pairs
    warnings: dict[str, int]
    notes: dict[str, int]


def recorded_joins(lanes: Sequence[MapLane], points: Sequence[np.ndarray]) -> Joins:
    """Connections that the lanes list, without those that no car can drive.

    Args:
      points: distinct points of each lane.
    """
    index = {lane.id: i for i, lane in enumerate(lanes)}
    listed = {(i, index[j]) for i, lane in enumerate(lanes) for j in lane.successors if j in index}
    listed |= {(index[j], i) for i, lane in enumerate(lanes) for j in lane.predecessors if j in index}
    ends = _Ends.of(points)
    pairs = _array(listed)
    gap, turn, step = ends.measures(pairs)
    faults = {
        f"listed lane connections refused, open by more than {MAX_JOIN_DISTANCE:g} m": gap > MAX_JOIN_DISTANCE,
        "listed lane connections refused, turned by more than 120 degrees": turn > MAX_TURN,
        f"listed lane connections refused, a step of more than {MAX_STEP:g} m in height": step > MAX_STEP,
    }
    sound = ~np.logical_or.reduce(list(faults.values()))
    meeting = _array(ends.near(JOIN_DISTANCE) - listed)
    _, turn, step = ends.measures(meeting)
    unlisted = int(((turn <= SAME_HEADING) & (step <= MAX_STEP)).sum())
    return Joins(
        _set(pairs[sound]),
        _positive({name: int(mask.sum()) for name, mask in faults.items()}),
        _positive({"lane ends that meet, but are not listed as connected": unlisted}),
    )


def inferred_joins(points: Sequence[np.ndarray], options: JoinOptions) -> Joins:
    """Connections of ends and starts that meet.

    Ends that are more than ``JOIN_DISTANCE`` apart must point the same way.
    """
    ends = _Ends.of(points)
    pairs = _array(ends.near(MAX_JOIN_DISTANCE))
    gap, turn, step = ends.measures(pairs)
    touching = gap <= JOIN_DISTANCE
    possible = (step <= MAX_STEP) & (turn <= np.where(touching, MAX_TURN, SAME_HEADING))
    joined = possible & (gap <= max(options.distance, JOIN_DISTANCE)) & (touching | (pairs[:, 0] != pairs[:, 1]))
    nearly = possible & ~joined & (pairs[:, 0] != pairs[:, 1])
    notes = {
        "lane ends that meet, but turn by more than 120 degrees or step in height": int((touching & ~possible).sum()),
        "lane ends that nearly meet, less than 1 m apart (--join-distance 1 joins them)": int(nearly.sum()),
    }
    return Joins(_set(pairs[joined]), {}, _positive(notes))


@dataclasses.dataclass(frozen=True)
class _Ends:
    """First and last points of lanes [m], and their directions [rad]."""

    first: Float64[np.ndarray, "lanes 3"]
    last: Float64[np.ndarray, "lanes 3"]
    first_heading: Float64[np.ndarray, " lanes"]
    last_heading: Float64[np.ndarray, " lanes"]

    @classmethod
    def of(cls, points: Sequence[np.ndarray]) -> _Ends:
        start = np.stack([line[1] - line[0] for line in points])
        end = np.stack([line[-1] - line[-2] for line in points])
        first, last = np.stack([line[0] for line in points]), np.stack([line[-1] for line in points])
        return cls(first, last, np.arctan2(start[:, 1], start[:, 0]), np.arctan2(end[:, 1], end[:, 0]))

    def near(self, distance: float) -> Pairs:
        """Pairs (i, j) where the end of i is so near to the start of j."""
        from scipy.spatial import KDTree

        matches = KDTree(self.last[:, :2]).query_ball_tree(KDTree(self.first[:, :2]), distance)
        return {(i, j) for i, followers in enumerate(matches) for j in followers}

    def measures(self, pairs: Int[np.ndarray, "pairs 2"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gap [m], turn [rad] and step in height [m] of each pair; a height that is not known is no step."""
        i, j = pairs.T
        offset = self.first[j] - self.last[i]
        turn = np.abs(np.angle(np.exp(1j * (self.first_heading[j] - self.last_heading[i]))))
        return np.hypot(offset[:, 0], offset[:, 1]), turn, np.nan_to_num(np.abs(offset[:, 2]), nan=0.0)


def _array(pairs: Pairs) -> Int[np.ndarray, "pairs 2"]:
    return np.array(sorted(pairs), np.int64).reshape(-1, 2)


def _set(pairs: np.ndarray) -> Pairs:
    return {(int(i), int(j)) for i, j in pairs}


def _positive(counts: dict[str, int]) -> dict[str, int]:
    return {name: count for name, count in counts.items() if count}
