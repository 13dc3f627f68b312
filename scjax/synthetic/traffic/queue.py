"""Vehicles on the map in the order in which they stand in their lanes, and who follows whom."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.traffic.fleet import Fleet

_MERGE_DISTANCE = 60.0  # m before a merge, within which the vehicles of both lanes alternate
_ALTERNATION_DISTANCE = 15.0  # m before a merge, from where on no vehicle is beside the one that it follows
_FALL_BACK = 0.5  # m of gap at least for every meter before that
_PARTING_DISTANCE = 4.0  # m after a fork, within which a vehicle in another branch is in the way
_NONE = -1


@dataclasses.dataclass(frozen=True)
class TrafficQueue:
    """Vehicles on the map, sorted by lane and position, arrays [vehicles on the map].

    Attributes:
      rows: indices in the fleet.
      lane, along, speed, next_lane, previous_lane: as in ``Fleet``.
      half_length: [m].
      remaining: from the center of the vehicle to the end of its lane [m].
      last_in_lane: index in the queue of the last vehicle of every lane, -1 for empty lanes [lanes].
    """

    rows: np.ndarray
    lane: np.ndarray
    along: np.ndarray
    speed: np.ndarray
    next_lane: np.ndarray
    previous_lane: np.ndarray
    half_length: np.ndarray
    remaining: np.ndarray
    last_in_lane: np.ndarray

    @classmethod
    def of(cls, fleet: Fleet, lanes: LaneArrays) -> TrafficQueue:
        """The queue of the vehicles of ``fleet`` that are on the map."""
        on_map = np.flatnonzero(fleet.lane >= 0)
        rows = on_map[np.lexsort((fleet.along[on_map], fleet.lane[on_map]))]
        lane, along = fleet.lane[rows], fleet.along[rows]
        last_in_lane = np.full(len(lanes.length), _NONE)
        last_in_lane[lane[::-1]] = np.arange(len(rows))[::-1]
        return cls(
            rows,
            lane,
            along,
            fleet.speed[rows],
            fleet.next_lane[rows],
            fleet.previous_lane[rows],
            half_length=fleet.sizes[rows, 0] / 2,
            remaining=lanes.length[lane] - along,
            last_in_lane=last_in_lane,
        )

    def find_leaders(self, lanes: LaneArrays) -> tuple[np.ndarray, np.ndarray]:
        """Gaps to the next vehicle [m], infinite without one, and its index in the queue, -1 without one."""
        lane, along, next_lane, remaining = self.lane, self.along, self.next_lane, self.remaining
        count = len(lane)
        indices = np.arange(count)
        leader = np.full(count, _NONE)
        gap = np.full(count, np.inf)
        has_leader_in_lane = np.append(lane[1:] == lane[:-1], False) if count else np.zeros(0, bool)
        leader[has_leader_in_lane] = indices[has_leader_in_lane] + 1
        gap[has_leader_in_lane] = (along[1:] - along[:-1])[has_leader_in_lane[:-1]]

        front = indices[~has_leader_in_lane & (next_lane >= 0)]
        first = self.last_in_lane[next_lane[front]]
        _take_closer(gap, leader, front, first, remaining[front] + along[first])
        lane_after = lanes.successors[next_lane[front], 0]
        second = np.where((first < 0) & (lane_after >= 0), self.last_in_lane[lane_after], _NONE)
        _take_closer(gap, leader, front, second, remaining[front] + lanes.length[next_lane[front]] + along[second])
        # A vehicle that has just left the lane by another branch may still be in the way.
        parting = np.full(len(lanes.length), _NONE)
        parted = indices[(self.previous_lane >= 0) & (along - self.half_length < _PARTING_DISTANCE)]
        parted = parted[np.argsort(-along[parted], kind="stable")]
        parting[self.previous_lane[parted]] = parted
        other = parting[lane[front]]
        _take_closer(gap, leader, front, other, remaining[front] + along[other])
        # Before a merge each vehicle follows the one that is next closer to it.
        merging = indices[(next_lane >= 0) & lanes.is_merge[next_lane] & (remaining < _MERGE_DISTANCE)]
        merging = merging[np.lexsort((remaining[merging], next_lane[merging]))]
        near, far = merging[:-1], merging[1:]
        same = next_lane[near] == next_lane[far]
        # Far from the merge there is time to fall back.
        distance = np.maximum(
            remaining[far] - remaining[near],
            _FALL_BACK * (remaining[far] - _ALTERNATION_DISTANCE) + self.half_length[far] + self.half_length[near],
        )
        _take_closer(gap, leader, far[same], near[same], distance[same])
        gap -= self.half_length + np.where(leader >= 0, self.half_length[leader], 0.0)
        return gap, leader

    def neighbors_at(self, lane: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Indices in the queue of the vehicles behind and ahead of places in lanes, -1 where there is none [n]."""
        key = self.lane * 1e5 + self.along
        place = np.searchsorted(key, lane * 1e5 + along)
        behind, ahead = place - 1, place
        inside = np.clip(behind, 0, len(key) - 1), np.clip(ahead, 0, len(key) - 1)
        behind = np.where((behind >= 0) & (self.lane[inside[0]] == lane), behind, _NONE)
        ahead = np.where((ahead < len(key)) & (self.lane[inside[1]] == lane), ahead, _NONE)
        return behind, ahead


def _take_closer(
    gap: np.ndarray, leader: np.ndarray, followers: np.ndarray, leaders: np.ndarray, distance: np.ndarray
) -> None:
    """Enters ``leaders`` [n] and their ``distance`` [m] for ``followers`` [n] wherever they are closer than before."""
    is_closer = (leaders >= 0) & (distance < gap[followers])
    gap[followers[is_closer]], leader[followers[is_closer]] = distance[is_closer], leaders[is_closer]
