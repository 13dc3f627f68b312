"""Where lanes cross or merge, and who goes first there; NumPy on the host."""

from __future__ import annotations

import collections
import dataclasses

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene.angles import wrap_to_pi

CONFLICT_DISTANCE = 2.2  # m between centerlines on which vehicles collide
_MERGE_ANGLE = np.deg2rad(60.0)  # at most, between lanes that merge
_SAME_WAY = np.deg2rad(20.0)  # lanes that only run beside each other differ by less
_STRAIGHT, _TURNS = np.deg2rad(25.0), np.deg2rad(150.0)  # change of heading of a lane straight on, and of a U-turn
_RING_LENGTH = 250.0  # m at most around a roundabout
RING, STRAIGHT, RIGHT, LEFT, BACK = 4, 3, 2, 1, 0  # right of way, the higher first


@dataclasses.dataclass(frozen=True)
class LaneConflicts:
    """Parts of lanes on which vehicles of two lanes collide, each once for either lane.

    Attributes:
      lane, other: the lane and the row of the same conflict as the other lane sees it.
      start, end: of the part, in xy arc length of the lane [m].
      merges: both lanes lead into the same lane.
    """

    lane: Int[np.ndarray, " conflicts"]
    other: Int[np.ndarray, " conflicts"]
    start: Float64[np.ndarray, " conflicts"]
    end: Float64[np.ndarray, " conflicts"]
    merges: Bool[np.ndarray, " conflicts"]


def find_conflicts(
    points: Float64[np.ndarray, "points 2"],
    headings: Float64[np.ndarray, " points"],
    lane: Int[np.ndarray, " points"],
    along: Float64[np.ndarray, " points"],
    successors: Int[np.ndarray, "edges 2"],
) -> LaneConflicts:
    """All pairs of lanes whose centerlines come closer than ``CONFLICT_DISTANCE``.

    Lanes that follow each other, leave the same lane side by side, or run the same way without merging are none.

    Args:
      points, headings, lane, along: of densely spaced points of all lanes [m, rad].
      successors: (i, j), lane j follows lane i.
    """
    from scipy.spatial import KDTree

    pairs = np.asarray(KDTree(points).query_pairs(CONFLICT_DISTANCE, output_type="ndarray"), int).reshape(-1, 2)
    pairs = pairs[lane[pairs[:, 0]] != lane[pairs[:, 1]]]
    grouped: dict[tuple[int, int], list[int]] = collections.defaultdict(list)
    for row, (a, b) in enumerate(np.sort(lane[pairs], axis=1).tolist()):
        grouped[a, b].append(row)
    follows = {(int(i), int(j)) for i, j in successors}
    after: dict[int, set[int]] = collections.defaultdict(set)
    before: dict[int, set[int]] = collections.defaultdict(set)
    for i, j in follows:
        after[i].add(j)
        before[j].add(i)
    lanes: list[int] = []
    others: list[int] = []
    starts: list[float] = []
    ends: list[float] = []
    merges: list[bool] = []
    for (a, b), rows in grouped.items():
        if (a, b) in follows or (b, a) in follows:
            continue
        both = pairs[rows]
        is_a = lane[both] == a
        at_a, at_b = both[is_a], both[~is_a]
        angle = np.abs(wrap_to_pi(headings[at_a] - headings[at_b]))
        joined = bool(after[a] & after[b])
        if joined and angle[np.argmax(along[at_a])] < _MERGE_ANGLE:
            joins = True
        elif angle.max() < _SAME_WAY or (before[a] & before[b] and not _crosses_later(along, at_a, at_b, angle)):
            continue
        else:
            joins = False
        for one, at, row in ((a, at_a, 1), (b, at_b, -1)):
            lanes.append(one)
            others.append(len(lanes) - 1 + row)
            starts.append(along[at].min() - 0.5)
            ends.append(along[at].max() + 0.5)
            merges.append(joins)
    return LaneConflicts(
        lane=np.array(lanes, int),
        other=np.array(others, int),
        start=np.array(starts, float),
        end=np.array(ends, float),
        merges=np.array(merges, bool),
    )


def _crosses_later(along: np.ndarray, at_a: np.ndarray, at_b: np.ndarray, angle: np.ndarray) -> bool:
    """Whether lanes that part from one lane meet again behind the place where they part."""
    far = (along[at_a] > 12.0) & (along[at_b] > 12.0) & (angle > _SAME_WAY)
    return bool(far.any())


def rank_lanes(
    turn: Float64[np.ndarray, " lanes"], length: Float64[np.ndarray, " lanes"], successors: Int[np.ndarray, "edges 2"]
) -> Int[np.ndarray, " lanes"]:
    """Right of way of every lane where it meets others: on a ring, straight on, right, left, back."""
    rank = np.where(turn > 0, LEFT, RIGHT)
    rank[np.abs(turn) < _STRAIGHT] = STRAIGHT
    rank[np.abs(turn) > _TURNS] = BACK
    after = collections.defaultdict(list)
    for i, j in successors:
        after[int(i)].append(int(j))
    for lane in range(len(turn)):
        if _is_on_ring(lane, length, after):
            rank[lane] = RING
    return rank


def _is_on_ring(lane: int, length: np.ndarray, after: dict[int, list[int]]) -> bool:
    """Whether a way of at most ``_RING_LENGTH`` leads from the lane back to itself."""
    best = {lane: 0.0}
    queue = [lane]
    while queue:
        one = queue.pop()
        for following in after[one]:
            reach = best[one] + length[one]
            if following == lane:
                return bool(reach <= _RING_LENGTH)
            if reach <= _RING_LENGTH and reach < best.get(following, np.inf):
                best[following] = reach
                queue.append(following)
    return False
