"""Right of way: vehicles need a grant for a connector, and walkers cross only where no vehicle has one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int

from scjax.scene import Signal
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.signals import SignalTiming
from scjax.synthetic.traffic.fleet import Fleet
from scjax.synthetic.traffic.queue import TrafficQueue

STOP_LINE_GAP = 1.2  # m between the front bumper and the stop line
_COMFORTABLE_DECELERATION = 3.0  # m/s^2, vehicles that would have to brake harder pass a yellow signal
_REQUEST_DISTANCE = 6.0  # m, and braking distance and 1 s, before which a vehicle requests a connector
_REQUEST_TIME = 1.0  # s
_RELEASE_DISTANCE = 0.5  # m behind a connector
_SLOW = 2.0  # m/s, of a vehicle that may block the way behind a connector
_NONE = -1


class RightOfWay:
    """Who may enter the connectors of ``lanes`` under the signals of ``timings``.

    Attributes:
      signals: current ``Signal`` of every lane [lanes].
      occupied: connectors that people cross; vehicles wait for them [lanes].
      num_grants: vehicles that may enter or are on each connector [lanes].
    """

    def __init__(self, lanes: LaneArrays, timings: list[SignalTiming]):
        self.lanes, self.timings = lanes, timings
        count = len(lanes.length)
        self.signals: Int[np.ndarray, " lanes"] = np.full(count, int(Signal.UNKNOWN))
        self.occupied: Bool[np.ndarray, " lanes"] = np.zeros(count, bool)
        self.num_grants: Int[np.ndarray, " lanes"] = np.zeros(count, int)
        self.update_signals(0.0)

    def update_signals(self, time: float) -> None:
        """Sets the signals to those at ``time`` [s]."""
        for timing in self.timings:
            for lane, state in timing.states(time).items():
                self.signals[lane] = int(state)

    def needs_grant(self, fleet: Fleet, queue: TrafficQueue) -> np.ndarray:
        """Which vehicles are before a connector that they may not enter."""
        is_before_connector = (queue.next_lane >= 0) & (self.lanes.junction[queue.next_lane] >= 0)
        return is_before_connector & (fleet.granted[queue.rows] != queue.next_lane)

    def grant(self, fleet: Fleet, queue: TrafficQueue) -> None:
        """Grants connectors to vehicles close to them, by rank, then by distance."""
        lanes = self.lanes
        reach = queue.speed**2 / (2 * _COMFORTABLE_DECELERATION) + _REQUEST_TIME * queue.speed + _REQUEST_DISTANCE
        requests = np.flatnonzero(self.needs_grant(fleet, queue) & (queue.remaining - queue.half_length < reach))
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
            has_conflict = self.occupied[connector] or self.num_grants[lanes.conflicts[connector]].any()
            if has_conflict or not (self._signal_allows(queue, k) and self._has_room_behind(queue, k)):
                blocked_lanes.add(lane)
                continue
            if (previous := fleet.granted[queue.rows[k]]) >= 0:  # a short road between two junctions
                self.num_grants[previous] -= 1
            fleet.granted[queue.rows[k]] = connector
            self.num_grants[connector] += 1
            waiting[lane].remove(queue.remaining[k])
            if not waiting[lane]:
                waiting[lane].append(np.inf)

    def withdraw(self, fleet: Fleet, queue: TrafficQueue) -> None:
        """Removes the grants of vehicles that can still stop at a signal that is not green any more."""
        if not self.timings:
            return
        state = self.signals[queue.next_lane]
        is_not_green = ((state == Signal.CAUTION) | (state == Signal.STOP)) & (queue.next_lane >= 0)
        stop_distance = queue.speed**2 / (2 * _COMFORTABLE_DECELERATION)
        can_stop = queue.remaining - queue.half_length - STOP_LINE_GAP > stop_distance
        has_grant = (fleet.granted[queue.rows] == queue.next_lane) & (queue.lane != queue.next_lane)
        self.release(fleet, queue.rows[has_grant & is_not_green & can_stop])

    def release(self, fleet: Fleet, rows: np.ndarray) -> None:
        """Removes the grants of vehicles."""
        np.subtract.at(self.num_grants, fleet.granted[rows], 1)
        fleet.granted[rows] = _NONE

    def release_passed(self, fleet: Fleet, leaving: np.ndarray) -> None:
        """Removes the grants of vehicles behind their connector and of those that are ``leaving`` the map (rows)."""
        holders = np.flatnonzero(fleet.granted >= 0)
        if not len(holders):
            return
        granted = fleet.granted[holders]
        is_behind = (fleet.lane[holders] != granted) & (fleet.next_lane[holders] != granted)
        is_behind &= fleet.along[holders] - fleet.sizes[holders, 0] / 2 > _RELEASE_DISTANCE
        self.release(fleet, np.union1d(holders[is_behind], leaving[fleet.granted[leaving] >= 0]))

    def _signal_allows(self, queue: TrafficQueue, k: int) -> bool:
        """Whether vehicle ``k`` of the queue may pass the signal; yellow only if it cannot stop comfortably."""
        signal = self.signals[queue.next_lane[k]]
        distance = queue.remaining[k] - queue.half_length[k] - STOP_LINE_GAP
        cannot_stop = queue.speed[k] ** 2 / (2 * _COMFORTABLE_DECELERATION) > distance
        return bool(signal in (Signal.UNKNOWN, Signal.GO) or (signal == Signal.CAUTION and cannot_stop))

    def _has_room_behind(self, queue: TrafficQueue, k: int) -> bool:
        """Whether vehicle ``k`` of the queue can leave its connector."""
        connector = queue.next_lane[k]
        exit_lane = self.lanes.successors[connector, 0]
        last = queue.last_in_lane[exit_lane] if exit_lane >= 0 else _NONE
        if last < 0 or queue.speed[last] > _SLOW:
            return True
        room = queue.along[last] - queue.half_length[last]
        return bool(room > 2 * queue.half_length[k] + 2.0 + 6.0 * self.num_grants[connector])
