"""Traffic simulation: driver model, lane changes, right of way and zipper merging."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.signals import SignalTiming
from scjax.synthetic.traffic.driver_model import DECELERATION, MIN_GAP, TIME_HEADWAY, accelerate
from scjax.synthetic.traffic.fleet import Fleet
from scjax.synthetic.traffic.lane_changes import change_lanes
from scjax.synthetic.traffic.queue import TrafficQueue
from scjax.synthetic.traffic.right_of_way import STOP_LINE_GAP, RightOfWay

TIME_STEP = 0.5  # s
_SPEED_MARGIN = 0.75  # of the deceleration, in front of a slower lane
_MAX_ENTRIES_PER_STEP = 3  # vehicles that enter the map
_STEPS_PER_DECISION = 2  # between decisions on lane changes
_BLOCKED_DISTANCE = 60.0  # m before an obstacle, within which vehicles try to leave the lane
_NONE = -1


class Obstacle(NamedTuple):
    """Something that vehicles of a lane keep behind: place of its near end [m] and speed along the lane [m/s]."""

    lane: int
    along: float
    speed: float = 0.0


class TrafficSimulation:
    """Vehicles on ``lanes`` under the signals of ``timings``.

    Attributes:
      fleet: the vehicles.
      right_of_way: grants and signals.
      obstacles: what stands or moves in lanes beside the vehicles.
      time: from 0 on [s].
    """

    def __init__(self, lanes: LaneArrays, timings: list[SignalTiming], fleet: Fleet, rng: np.random.Generator):
        self.lanes, self.fleet, self.rng = lanes, fleet, rng
        self.right_of_way = RightOfWay(lanes, timings)
        self.obstacles: tuple[Obstacle, ...] = ()
        self.time = 0.0
        self._num_steps = 0
        self._has_neighbors = bool((lanes.left >= 0).any())

    @property
    def signals(self) -> Int[np.ndarray, " lanes"]:
        """Current ``Signal`` of every lane."""
        return self.right_of_way.signals

    def run(self, seconds: float) -> None:
        """Simulates ``seconds``, in steps of ``TIME_STEP``."""
        for _ in range(round(seconds / TIME_STEP)):
            self.step()

    def step(self) -> None:
        """Simulates one step."""
        fleet, queue, way = self.fleet, TrafficQueue.of(self.fleet, self.lanes), self.right_of_way
        gap, leader = queue.find_leaders(self.lanes)
        way.withdraw(fleet, queue)
        way.grant(fleet, queue)
        stop_gap = np.where(way.needs_grant(fleet, queue), queue.remaining - queue.half_length - STOP_LINE_GAP, np.inf)
        obstacle_gap, obstacle_speed = self._obstacles_ahead(queue)
        gaps = np.stack([gap, stop_gap, obstacle_gap])
        speed = queue.speed
        limit = self._speed_limits(queue)
        leader_speed = np.where(leader >= 0, speed[leader], 0.0)
        closing_speed = np.stack([speed - leader_speed, speed, speed - obstacle_speed])
        # No time headway applies to a stop line.
        headways, min_gaps = np.array([[TIME_HEADWAY], [0.0], [0.0]]), MIN_GAP * np.array([[1.0], [0.25], [1.0]])
        acceleration = accelerate(speed, limit, gaps, closing_speed, headways, min_gaps)
        new_speed = np.maximum(0.0, speed + TIME_STEP * acceleration)
        new_speed = np.minimum(new_speed, np.maximum(limit, speed))
        distance = np.minimum((speed + new_speed) / 2 * TIME_STEP, np.maximum(gaps.min(0) - 0.3, 0.0))
        max_speed = np.maximum(2 * distance / TIME_STEP - speed, 0.0) + 2.0 * (distance > 0)
        fleet.along[queue.rows], fleet.speed[queue.rows] = queue.along + distance, np.minimum(new_speed, max_speed)
        if self._has_neighbors and self._num_steps % _STEPS_PER_DECISION == 0:
            change_lanes(fleet, queue, self.lanes, gap, leader, obstacle_gap < _BLOCKED_DISTANCE, self.rng)
        self._move_sideways(queue.rows)
        self._move_to_next_lanes(queue.rows)
        self._num_steps += 1
        self.time += TIME_STEP
        way.update_signals(self.time)
        self._enter_map()

    def _speed_limits(self, queue: TrafficQueue) -> np.ndarray:
        """Desired speeds: that of the lane, or less in front of a slower lane [m/s]."""
        lanes, factor = self.lanes, self.fleet.speed_factor[queue.rows]
        limit = lanes.speed[queue.lane] * factor
        next_limit = np.where(queue.next_lane >= 0, lanes.speed[queue.next_lane] * factor, limit)
        braking = 2 * DECELERATION * _SPEED_MARGIN * np.maximum(queue.remaining, 0.0)
        return np.minimum(limit, np.sqrt(next_limit**2 + braking))

    def _obstacles_ahead(self, queue: TrafficQueue) -> tuple[np.ndarray, np.ndarray]:
        """Gaps [m] to the nearest obstacle in the lane or the next one, infinite without one, and its speed [m/s]."""
        gap, speed = np.full(len(queue.rows), np.inf), np.zeros(len(queue.rows))
        for obstacle in self.obstacles:
            in_lane = (queue.lane == obstacle.lane) & (queue.along < obstacle.along)
            distance = np.where(in_lane, obstacle.along - queue.along, np.inf)
            distance = np.where(queue.next_lane == obstacle.lane, queue.remaining + obstacle.along, distance)
            distance = distance - queue.half_length
            is_closer = distance < gap
            gap, speed = np.where(is_closer, distance, gap), np.where(is_closer, obstacle.speed, speed)
        return gap, speed

    def _move_sideways(self, rows: np.ndarray) -> None:
        """Moves vehicles towards their goal beside the centerline, while they drive."""
        fleet = self.fleet
        step = np.minimum(fleet.lateral_speed[rows], 0.35 * fleet.speed[rows]) * TIME_STEP
        fleet.lateral[rows] += np.clip(fleet.lateral_goal[rows] - fleet.lateral[rows], -step, step)

    def _move_to_next_lanes(self, rows: np.ndarray) -> None:
        """Moves vehicles past the end of their lane to the next one or off the map, and releases connectors."""
        fleet, lanes = self.fleet, self.lanes
        past_end = rows[fleet.along[rows] >= lanes.length[fleet.lane[rows]]]
        leaving = past_end[fleet.next_lane[past_end] < 0]
        moving = past_end[fleet.next_lane[past_end] >= 0]
        fleet.along[moving] -= lanes.length[fleet.lane[moving]]
        fleet.previous_lane[moving] = fleet.lane[moving]
        fleet.lane[moving] = fleet.next_lane[moving]
        uniform = self.rng.random(len(moving))
        fleet.next_lane[moving] = lanes.pick_successors(fleet.lane[moving], uniform, fleet.sizes[moving, 0])
        self.right_of_way.release_passed(fleet, leaving)
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
                fleet.next_lane[k] = lanes.pick_successors(np.array([lane]), self.rng.random(1), np.array([length]))[0]
                fleet.previous_lane[k] = _NONE
                fleet.entries[k] += 1
                room[lane] = 0.0
