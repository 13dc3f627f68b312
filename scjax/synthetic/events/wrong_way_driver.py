"""Wrong-way driver: a vehicle on a lane, against its direction."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import LEAD_TIME, StagedEvent, remove_vehicles
from scjax.synthetic.traffic import TIME_STEP, Obstacle, TrafficSimulation

_SPEEDS = (4.0, 9.0)  # m/s
_CLEAR_DISTANCE = 15.0  # m of lane without vehicles behind the driver at the start
_MIN_GAP = 6.0  # m to oncoming vehicles
_DECELERATION = 4.0  # m/s^2
_END = 3.0  # m from the start of the lane, where the driver stops
_MIN_SPEED = 3.0  # m/s at the moment


class WrongWayDriver(StagedEvent):
    event = "wrong-way"
    _place, _speed, _size = 0.0, 0.0, np.zeros((1, 3))

    def start(self, simulation: TrafficSimulation, rng: np.random.Generator) -> None:
        super().start(simulation, rng)
        self.move_near_traffic(simulation, rng)
        room = self.lanes.length[self.lane] - self.along
        self._speed = min(float(rng.uniform(*_SPEEDS)), (room - _END) / LEAD_TIME)
        self._place = self.along + LEAD_TIME * self._speed
        self._size = actors.draw_vehicle_sizes(1, rng, long=False)
        fleet = simulation.fleet
        in_way = (fleet.lane == self.lane) & (fleet.along > self.along)
        remove_vehicles(simulation, np.flatnonzero(in_way & (fleet.along < self._place + _CLEAR_DISTANCE)))

    def step(self, simulation: TrafficSimulation) -> None:
        if not self.number:
            return
        fleet = simulation.fleet
        ahead = (fleet.lane == self.lane) & (fleet.along < self._place)
        fronts = (fleet.along + fleet.sizes[:, 0] / 2)[ahead]
        gap = self._place - self._size[0, 0] / 2 - (fronts.max() if len(fronts) else _END - _MIN_GAP)
        allowed = np.sqrt(2 * _DECELERATION * max(gap - _MIN_GAP, 0.0)) / 2  # both vehicles brake
        self._speed = float(min(self._speed, max(allowed, self._speed - _DECELERATION * TIME_STEP)))
        self._place -= min(self._speed * TIME_STEP, max(gap - 1.0, 0.0))

    def obstacles(self) -> tuple[Obstacle, ...]:
        if not self.number:
            return ()
        return (Obstacle(self.lane, self._place - self._size[0, 0] / 2, -self._speed),)

    def actors(self) -> Actors:
        if not self.number:
            return actors.no_actors()
        position, heading = self.pose(self._place)
        return self.with_ids(
            actors.make_actors(AgentType.VEHICLE, position, heading + np.pi, self._speed, self._size, lane=self.lane)
        )

    def find(self, scene: Actors) -> int | None:
        return self.find_staged(scene) if self._speed > _MIN_SPEED else None
