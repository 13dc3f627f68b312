"""Traffic simulation: intelligent driver model, traffic signals, right of way and zipper merging.

Vehicles keep to their lane. A vehicle needs a grant to enter a connector. Grants go by rank and distance, while no
conflicting connector is granted, the signal allows it, and there is room behind the connector.

Driver model: Treiber, Hennecke, Helbing, "Congested traffic states in empirical observations and microscopic
simulations", Phys. Rev. E 62 (2000), eqs. 1-3.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import Signal
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.signals import SignalTiming

TIME_STEP = 0.5  # s
# Intelligent driver model.
_ACCELERATION, _DECELERATION = 1.5, 2.0  # m/s^2
_MAX_DECELERATION = 6.0  # m/s^2
_TIME_HEADWAY, _MIN_GAP = 1.3, 2.0  # s, m
_SPEED_MARGIN = 0.75  # of the deceleration, in front of a slower lane
# Intersections.
_COMFORTABLE_DECELERATION = 3.0  # m/s^2, vehicles that would have to brake harder pass a yellow signal
_STOP_LINE_GAP = 1.2  # m between the front bumper and the stop line
_REQUEST_DISTANCE = 6.0  # m, and braking distance and 2.5 s, before which a vehicle requests a connector
_REQUEST_TIME = 2.5  # s
_RELEASE_DISTANCE = 0.5  # m behind a connector
_MERGE_DISTANCE = 60.0  # m before a merge, within which the vehicles of both lanes alternate
_PARTING_DISTANCE = 4.0  # m after a fork, within which a vehicle in another branch is in the way
_MAX_ENTRIES_PER_STEP = 3  # vehicles that enter the map
_NONE = -1


@dataclasses.dataclass
class Fleet:
    """Vehicles of a simulation, arrays [vehicles].

    Attributes:
      lane: index of the lane; -1 for vehicles that wait to enter the map.
      along: position of the center along the lane [m].
      speed: [m/s].
      next_lane: lane that follows; -1 at the border of the map.
      granted: connector that the vehicle may enter; -1 for none.
      sizes: length, width, height [m].
      speed_factor: desired speed relative to that of the lane.
      lateral: offset to the left of the centerline [m].
    """

    lane: Int[np.ndarray, " n"]
    along: Float64[np.ndarray, " n"]
    speed: Float64[np.ndarray, " n"]
    next_lane: Int[np.ndarray, " n"]
    granted: Int[np.ndarray, " n"]
    sizes: Float64[np.ndarray, "n 3"]
    speed_factor: Float64[np.ndarray, " n"]
    lateral: Float64[np.ndarray, " n"]


@dataclasses.dataclass(frozen=True)
class _Queue:
    """Vehicles on the map, sorted by lane and position, arrays [vehicles on the map].

    Attributes:
      rows: indices in the fleet.
      lane, along, speed, next_lane: as in ``Fleet``.
      half_length: [m].
      remaining: from the center of the vehicle to the end of its lane [m].
      last_in_lane: index in the queue of the last vehicle of every lane, -1 for empty lanes [lanes].
    """

    rows: np.ndarray
    lane: np.ndarray
    along: np.ndarray
    speed: np.ndarray
    next_lane: np.ndarray
    half_length: np.ndarray
    remaining: np.ndarray
    last_in_lane: np.ndarray

    @classmethod
    def of(cls, fleet: Fleet, lanes: LaneArrays) -> _Queue:
        on_map = np.flatnonzero(fleet.lane >= 0)
        rows = on_map[np.lexsort((fleet.along[on_map], fleet.lane[on_map]))]
        lane, along = fleet.lane[rows], fleet.along[rows]
        last_in_lane = np.full(len(lanes.length), _NONE)
        last_in_lane[lane[::-1]] = np.arange(len(rows))[::-1]
        half_length = fleet.sizes[rows, 0] / 2
        remaining = lanes.length[lane] - along
        return cls(rows, lane, along, fleet.speed[rows], fleet.next_lane[rows], half_length, remaining, last_in_lane)


class TrafficSimulation:
    """Vehicles on ``lanes`` under the signals of ``timings``; ``time`` starts at 0 [s]."""

    def __init__(self, lanes: LaneArrays, timings: list[SignalTiming], fleet: Fleet, rng: np.random.Generator):
        self.lanes, self.timings, self.fleet, self.rng = lanes, timings, fleet, rng
        self.time = 0.0
        self._num_grants = np.zeros(len(lanes.length), int)  # per connector
        self._signals = np.full(len(lanes.length), int(Signal.UNKNOWN))
        self._update_signals()

    @property
    def signals(self) -> Int[np.ndarray, " lanes"]:
        """Current ``Signal`` of every lane."""
        return self._signals

    def run(self, seconds: float) -> None:
        """Simulates ``seconds``, in steps of ``TIME_STEP``."""
        for _ in range(round(seconds / TIME_STEP)):
            self._step()

    def _step(self) -> None:
        fleet, queue = self.fleet, _Queue.of(self.fleet, self.lanes)
        gap, leader = self._find_leaders(queue)
        self._withdraw_grants(queue)
        self._grant_connectors(queue)
        must_stop = self._needs_grant(queue)
        stop_gap = np.where(must_stop, queue.remaining - queue.half_length - _STOP_LINE_GAP, np.inf)
        gaps = np.stack([gap, stop_gap])
        speed = queue.speed
        limit = self._speed_limits(queue)
        leader_speed = np.where(leader >= 0, speed[leader], 0.0)
        closing_speed = np.stack([speed - leader_speed, speed])
        # Desired gaps to the leader and to the stop line; no time headway applies to a stop line.
        desired_gap = _MIN_GAP * np.array([[1.0], [0.25]]) + np.maximum(
            0.0,
            speed * np.array([[_TIME_HEADWAY], [0.0]])
            + speed * closing_speed / (2 * np.sqrt(_ACCELERATION * _DECELERATION)),
        )
        interaction = (desired_gap / np.maximum(gaps, 0.1)).max(0) ** 2
        acceleration = _ACCELERATION * (1 - (speed / limit) ** 4 - interaction)
        new_speed = np.maximum(0.0, speed + TIME_STEP * np.clip(acceleration, -_MAX_DECELERATION, _ACCELERATION))
        new_speed = np.minimum(new_speed, np.maximum(limit, speed))
        distance = np.minimum((speed + new_speed) / 2 * TIME_STEP, np.maximum(gaps.min(0) - 0.3, 0.0))
        max_speed = np.maximum(2 * distance / TIME_STEP - speed, 0.0) + 2.0 * (distance > 0)
        fleet.along[queue.rows], fleet.speed[queue.rows] = queue.along + distance, np.minimum(new_speed, max_speed)
        self._move_to_next_lanes(queue.rows)
        self.time += TIME_STEP
        self._update_signals()
        self._enter_map()

    def _speed_limits(self, queue: _Queue) -> np.ndarray:
        """Desired speeds: that of the lane, or less in front of a slower lane [m/s]."""
        lanes, factor = self.lanes, self.fleet.speed_factor[queue.rows]
        limit = lanes.speed[queue.lane] * factor
        next_limit = np.where(queue.next_lane >= 0, lanes.speed[queue.next_lane] * factor, limit)
        braking = 2 * _DECELERATION * _SPEED_MARGIN * np.maximum(queue.remaining, 0.0)
        return np.minimum(limit, np.sqrt(next_limit**2 + braking))

    def _needs_grant(self, queue: _Queue) -> np.ndarray:
        """Which vehicles are before a connector that they may not enter."""
        is_before_connector = (queue.next_lane >= 0) & (self.lanes.junction[queue.next_lane] >= 0)
        return is_before_connector & (self.fleet.granted[queue.rows] != queue.next_lane)

    def _find_leaders(self, queue: _Queue) -> tuple[np.ndarray, np.ndarray]:
        """Gaps to the next vehicle [m], infinite without one, and its index in the queue, -1 without one."""
        lanes, count = self.lanes, len(queue.lane)
        lane, along, next_lane, remaining = queue.lane, queue.along, queue.next_lane, queue.remaining
        indices = np.arange(count)
        leader = np.full(count, _NONE)
        gap = np.full(count, np.inf)
        has_leader_in_lane = np.append(lane[1:] == lane[:-1], False) if count else np.zeros(0, bool)
        leader[has_leader_in_lane] = indices[has_leader_in_lane] + 1
        gap[has_leader_in_lane] = (along[1:] - along[:-1])[has_leader_in_lane[:-1]]

        def consider(followers: np.ndarray, leaders: np.ndarray, distance: np.ndarray) -> None:
            is_closer = (leaders >= 0) & (distance < gap[followers])
            gap[followers[is_closer]], leader[followers[is_closer]] = distance[is_closer], leaders[is_closer]

        front = indices[~has_leader_in_lane & (next_lane >= 0)]
        first = queue.last_in_lane[next_lane[front]]
        consider(front, first, remaining[front] + along[first])
        lane_after = lanes.successors[next_lane[front], 0]
        second = np.where((first < 0) & (lane_after >= 0), queue.last_in_lane[lane_after], _NONE)
        consider(front, second, remaining[front] + lanes.length[next_lane[front]] + along[second])
        # A vehicle that has just left the lane by another connector may still be in the way.
        parting = np.full(len(lanes.length), _NONE)
        parted = indices[(lanes.entry_lane[lane] >= 0) & (along - queue.half_length < _PARTING_DISTANCE)]
        parted = parted[np.argsort(-along[parted], kind="stable")]
        parting[lanes.entry_lane[lane[parted]]] = parted
        other = parting[lane[front]]
        consider(front, other, remaining[front] + along[other])
        # Before a merge each vehicle follows the one that is next closer to it.
        merging = indices[(next_lane >= 0) & lanes.is_merge[next_lane] & (remaining < _MERGE_DISTANCE)]
        merging = merging[np.lexsort((remaining[merging], next_lane[merging]))]
        near, far = merging[:-1], merging[1:]
        same = next_lane[near] == next_lane[far]
        consider(far[same], near[same], (remaining[far] - remaining[near])[same])
        gap -= queue.half_length + np.where(leader >= 0, queue.half_length[leader], 0.0)
        return gap, leader

    def _grant_connectors(self, queue: _Queue) -> None:
        """Grants connectors to vehicles close to them, by rank, then by distance."""
        fleet, lanes = self.fleet, self.lanes
        reach = queue.speed**2 / (2 * _DECELERATION) + _REQUEST_TIME * queue.speed + _REQUEST_DISTANCE
        requests = np.flatnonzero(self._needs_grant(queue) & (queue.remaining - queue.half_length < reach))
        if not len(requests):
            return
        requests = requests[np.lexsort((queue.remaining[requests], lanes.rank[queue.next_lane[requests]]))]
        blocked_lanes: set[int] = set()
        # Within a lane the first vehicle goes first, whatever its turn.
        waiting: dict[int, list[float]] = {}
        for k in map(int, requests):
            waiting.setdefault(queue.lane[k], []).append(queue.remaining[k])
        for k in map(int, requests):
            lane, connector = queue.lane[k], queue.next_lane[k]
            if lane in blocked_lanes or queue.remaining[k] > min(waiting[lane]) + 1e-6:
                blocked_lanes.add(lane)
                continue
            has_conflict = self._num_grants[lanes.conflicts[connector]].any()
            if not (self._signal_allows(queue, k) and self._has_room_behind(queue, k)) or has_conflict:
                blocked_lanes.add(lane)
                continue
            if (previous := fleet.granted[queue.rows[k]]) >= 0:  # a short road between two junctions
                self._num_grants[previous] -= 1
            fleet.granted[queue.rows[k]] = connector
            self._num_grants[connector] += 1
            waiting[lane].remove(queue.remaining[k])
            if not waiting[lane]:
                waiting[lane].append(np.inf)

    def _signal_allows(self, queue: _Queue, k: int) -> bool:
        """Whether vehicle ``k`` of the queue may pass the signal; yellow only if it cannot stop comfortably."""
        signal = self._signals[queue.next_lane[k]]
        distance = queue.remaining[k] - queue.half_length[k] - _STOP_LINE_GAP
        cannot_stop = queue.speed[k] ** 2 / (2 * _COMFORTABLE_DECELERATION) > distance
        return bool(signal in (Signal.UNKNOWN, Signal.GO) or (signal == Signal.CAUTION and cannot_stop))

    def _has_room_behind(self, queue: _Queue, k: int) -> bool:
        """Whether vehicle ``k`` of the queue can leave its connector."""
        connector = queue.next_lane[k]
        exit_lane = self.lanes.successors[connector, 0]
        last = queue.last_in_lane[exit_lane] if exit_lane >= 0 else _NONE
        if last < 0 or queue.speed[last] > 2.0:
            return True
        room = queue.along[last] - queue.half_length[last]
        return bool(room > 2 * queue.half_length[k] + 2.0 + 6.0 * self._num_grants[connector])

    def _withdraw_grants(self, queue: _Queue) -> None:
        """Removes the grants of vehicles that can still stop at a signal that is not green any more."""
        fleet = self.fleet
        is_not_green = np.isin(self._signals[queue.next_lane], (Signal.CAUTION, Signal.STOP)) & (queue.next_lane >= 0)
        stop_distance = queue.speed**2 / (2 * _COMFORTABLE_DECELERATION)
        can_stop = queue.remaining - queue.half_length - _STOP_LINE_GAP > stop_distance
        has_grant = (fleet.granted[queue.rows] == queue.next_lane) & (queue.lane != queue.next_lane)
        self._release(queue.rows[has_grant & is_not_green & can_stop])

    def _release(self, rows: np.ndarray) -> None:
        """Removes the grants of vehicles."""
        np.subtract.at(self._num_grants, self.fleet.granted[rows], 1)
        self.fleet.granted[rows] = _NONE

    def _move_to_next_lanes(self, rows: np.ndarray) -> None:
        """Moves vehicles past the end of their lane to the next one or off the map, and releases connectors."""
        fleet, lanes = self.fleet, self.lanes
        past_end = rows[fleet.along[rows] >= lanes.length[fleet.lane[rows]]]
        leaving = past_end[fleet.next_lane[past_end] < 0]
        moving = past_end[fleet.next_lane[past_end] >= 0]
        fleet.along[moving] -= lanes.length[fleet.lane[moving]]
        fleet.lane[moving] = fleet.next_lane[moving]
        fleet.next_lane[moving] = lanes.pick_successors(fleet.lane[moving], self.rng.random(len(moving)))
        holders = np.flatnonzero(fleet.granted >= 0)
        granted = fleet.granted[holders]
        is_behind = (fleet.lane[holders] != granted) & (fleet.next_lane[holders] != granted)
        is_behind &= fleet.along[holders] - fleet.sizes[holders, 0] / 2 > _RELEASE_DISTANCE
        self._release(np.concatenate([holders[is_behind], leaving[fleet.granted[leaving] >= 0]]))
        fleet.lane[leaving] = _NONE

    def _enter_map(self) -> None:
        """Lets vehicles that left the map enter it again, on lanes with room."""
        fleet, lanes = self.fleet, self.lanes
        waiting = np.flatnonzero(fleet.lane < 0)
        if not len(waiting) or not len(lanes.entries):
            return
        room = np.full(len(lanes.length), np.inf)  # from the start of each lane to its last vehicle [m]
        on_map = np.flatnonzero(fleet.lane >= 0)
        np.minimum.at(room, fleet.lane[on_map], fleet.along[on_map] - fleet.sizes[on_map, 0] / 2)
        for k in waiting[:_MAX_ENTRIES_PER_STEP]:
            lane = int(self.rng.choice(lanes.entries))
            length, speed = fleet.sizes[k, 0], 0.8 * lanes.speed[lane] * fleet.speed_factor[k]
            if room[lane] > length + 4.0 + 1.5 * speed:
                fleet.lane[k], fleet.along[k], fleet.speed[k] = lane, length / 2, speed
                fleet.next_lane[k] = lanes.pick_successors(np.array([lane]), self.rng.random(1))[0]
                room[lane] = 0.0

    def _update_signals(self) -> None:
        for timing in self.timings:
            for lane, state in timing.states(self.time).items():
                self._signals[lane] = int(state)


def draw_fleet(
    lanes: LaneArrays,
    density: Float64[np.ndarray, " lanes"],
    draw_sizes: Callable[[int], np.ndarray],
    rng: np.random.Generator,
) -> Fleet:
    """A random fleet on lanes that are no connectors.

    Args:
      density: vehicles per meter of each lane.
      draw_sizes: function (count) -> lengths, widths, heights [count, 3].
    """
    counts = rng.poisson(density * lanes.length * (lanes.junction < 0))
    lane = np.repeat(np.arange(len(counts)), counts)
    sizes = draw_sizes(len(lane))
    # Each lane has equal slots; slots that are too short for a vehicle and its gap stay empty.
    number = np.arange(len(lane)) - np.repeat(np.cumsum(counts) - counts, counts)
    slot = lanes.length[lane] / counts[lane]
    along = (number + rng.uniform(0.25, 0.75, len(lane))) * slot
    fits = slot > 2 * sizes[:, 0] + 3.0
    lane, along, sizes, slot = lane[fits], along[fits], sizes[fits], slot[fits]
    speed_factor = np.clip(rng.normal(1.05, 0.12, len(lane)), 0.7, 1.35)
    speed = np.minimum(lanes.speed[lane] * speed_factor, np.maximum((slot - sizes[:, 0]) / 2.5, 0.0))
    next_lane = lanes.pick_successors(lane, rng.random(len(lane)))
    # Most vehicles keep to the centerline; some change lanes, turn wide, or make room.
    spread = np.where(rng.random(len(lane)) < 0.3, 0.6, 0.22)
    lateral = np.clip(spread * rng.normal(size=len(lane)), -1.4, 1.4)
    return Fleet(lane, along, speed, next_lane, np.full(len(lane), _NONE), sizes, speed_factor, lateral)
