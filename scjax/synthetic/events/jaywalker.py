"""Jaywalker: a pedestrian who crosses a road away from junctions."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import LEAD_TIME, StagedEvent, remove_vehicles
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import TIME_STEP, Obstacle, TrafficSimulation

_SPEEDS = (1.0, 1.9)  # m/s
_MAX_LATERAL = 0.8  # m from the centerline at the moment
_REACH = 14.0  # m of lanes to both sides that the walker may cross
_OBSTACLE_BEFORE, _OBSTACLE_BEHIND = 4.0, 1.6  # m of way: vehicles wait from before until behind a lane
_BRAKING = 4.5  # m/s^2, vehicles that would have to brake harder are taken away at the start
_GAP = 1.5  # m between a vehicle that waits and the way


class Jaywalker(StagedEvent):
    event = "jaywalker"

    def __init__(self, *place):
        super().__init__(*place)
        self._lanes, self._crossed_along, self._offset = np.zeros(0, int), np.zeros(0), np.zeros(0)
        self._way, self._speed, self._side, self._heading = 0.0, 0.0, 1.0, 0.0
        self._size = np.zeros((1, 3))

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        return net.lanes[lane].subtype != "freeway"

    def start(self, simulation: TrafficSimulation, rng: np.random.Generator) -> None:
        super().start(simulation, rng)
        self.move_near_traffic(simulation, rng)
        self._lanes, self._crossed_along, self._offset = self._find_lanes()
        self._speed, self._side = float(rng.uniform(*_SPEEDS)), float(rng.choice([-1.0, 1.0]))
        self._heading = float(rng.normal(0, 0.15))
        self._size = actors.draw_sizes(AgentType.PEDESTRIAN, 1, rng)
        self._way = float(rng.uniform(-_MAX_LATERAL, _MAX_LATERAL)) - LEAD_TIME * self._speed
        fleet = simulation.fleet
        for lane, along in zip(self._lanes, self._crossed_along, strict=True):
            distance = np.where(fleet.lane == lane, along - fleet.along, np.inf)
            too_fast = fleet.speed**2 / (2 * _BRAKING) + 4.0 > distance - fleet.sizes[:, 0] / 2
            remove_vehicles(simulation, np.flatnonzero(too_fast & (distance > -fleet.sizes[:, 0])))

    def step(self, simulation: TrafficSimulation) -> None:
        self._way += self._speed * TIME_STEP

    def obstacles(self) -> tuple[Obstacle, ...]:
        if not self.number:
            return ()
        before = self._side * self._offset - self._way  # m to go to each lane
        waits = (before < _OBSTACLE_BEFORE) & (before > -_OBSTACLE_BEHIND)
        return tuple(
            Obstacle(int(lane), float(along) - _GAP)
            for lane, along in zip(self._lanes[waits], self._crossed_along[waits], strict=True)
        )

    def actors(self) -> Actors:
        if not self.number:
            return actors.no_actors()
        position, lane_heading = self.pose()
        heading = lane_heading + self._side * (np.pi / 2 + self._heading)
        position = position + self._way * np.stack([np.cos(heading), np.sin(heading)], -1)
        return self.with_ids(
            actors.make_actors(AgentType.PEDESTRIAN, position, heading, self._speed, self._size, lane=self.lane)
        )

    def find(self, scene: Actors) -> int | None:
        return self.find_staged(scene)

    def _find_lanes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lanes that a way straight across meets: index, place along them [m], offset to the left [m]."""
        lanes, (position, heading) = self.lanes, self.pose()
        direction = np.array([np.cos(heading[0]), np.sin(heading[0])])
        offset = lanes.points - position
        ahead = offset @ direction
        left = direction[0] * offset[:, 1] - direction[1] * offset[:, 0]
        changes = np.flatnonzero(((ahead[:-1] < 0) != (ahead[1:] < 0)) & (np.abs(left[:-1]) < _REACH))
        lane = np.searchsorted(lanes.start, changes, side="right") - 1
        inside = changes + 1 < lanes.start[lane] + lanes.count[lane]
        changes, lane = changes[inside], lane[inside]
        along = (changes - lanes.start[lane] + 0.5) * lanes.length[lane] / (lanes.count[lane] - 1)
        return lane, along, left[changes]
