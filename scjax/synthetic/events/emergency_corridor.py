"""Emergency corridor: a jam that makes way for an ambulance between two lanes."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import LEAD_TIME, StagedEvent, add_vehicles
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import TIME_STEP, Fleet, TrafficSimulation

_VEHICLES_PER_LANE = 9
_SPACING = (8.5, 11.0)  # m between vehicles of the jam
_SPEED_FACTORS = (0.04, 0.09)
_MIN_END_DISTANCE = 4.0  # m from a vehicle to the ends of its lane
_LEFT_SHIFT, _RIGHT_SHIFT = 0.85, -0.75  # m to the left, of the vehicles in the leftmost lane and in the others
_AMBULANCE_SIZE = np.array([[5.6, 2.0, 2.6]])  # m
_SPEEDS = (3.0, 6.0)  # m/s of the ambulance
_MIN_VEHICLES = 2  # on either side
_VIEW = 22.0  # m


class EmergencyCorridor(StagedEvent):
    event = "emergency-corridor"
    clearance = 110.0  # the jam is long

    def __init__(self, *place):
        super().__init__(*place)
        self._abreast = self.net.lanes_abreast(self.lane)
        self._place, self._speed = 0.0, 0.0

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        """The rightmost of several lanes."""
        return net.lanes[lane].left is not None and net.lanes[lane].right is None

    def prepare_traffic(self, fleet: Fleet, rng: np.random.Generator) -> Fleet:
        """The fleet with a jam on all lanes abreast."""
        lane = np.repeat(self._abreast, _VEHICLES_PER_LANE)
        number = np.tile(np.arange(_VEHICLES_PER_LANE), len(self._abreast)) - _VEHICLES_PER_LANE // 2
        along = self.along + number * rng.uniform(*_SPACING)
        fits = (along > _MIN_END_DISTANCE) & (along < self.lanes.length[lane] - _MIN_END_DISTANCE)
        lane, along = lane[fits], along[fits] + rng.uniform(-0.8, 0.8, fits.sum())
        factor, lateral = rng.uniform(*_SPEED_FACTORS, len(lane)), self._shift(lane)
        others = fleet.select(~np.isin(fleet.lane, self._abreast))
        return add_vehicles(others, self.lanes, lane, along, np.zeros(len(lane)), factor, lateral, rng)

    def start(self, simulation: TrafficSimulation, rng: np.random.Generator) -> None:
        super().start(simulation, rng)
        self._speed = float(rng.uniform(*_SPEEDS))
        self._place = self.along - LEAD_TIME * self._speed

    def step(self, simulation: TrafficSimulation) -> None:
        """Vehicles that come to the jam make way, too."""
        self._place = min(self._place + self._speed * TIME_STEP, self.lanes.length[self._abreast[0]] - 3.0)
        fleet = simulation.fleet
        rows = np.flatnonzero(np.isin(fleet.lane, self._abreast) & (fleet.speed < 3.0))
        fleet.lateral_goal[rows] = self._shift(fleet.lane[rows])

    def actors(self) -> Actors:
        if not self.number:
            return actors.no_actors()
        leftmost = self._abreast[0]
        position, heading = self.lanes.poses_at(np.array([leftmost]), np.array([self._place]))
        right = np.stack([np.sin(heading), -np.cos(heading)], -1)
        position = position + (0.5 * self.net.lanes[leftmost].width + (_LEFT_SHIFT + _RIGHT_SHIFT) / 2) * right
        return self.with_ids(
            actors.make_actors(AgentType.VEHICLE, position, heading, self._speed, _AMBULANCE_SIZE, lane=leftmost)
        )

    def find(self, scene: Actors) -> int | None:
        queued = np.isin(scene.lane, self._abreast) & (scene.types == AgentType.VEHICLE)
        agent = self.find_staged(scene)
        if agent is None:
            return None
        queued[agent] = False
        is_left = scene.lane[queued] == self._abreast[0]
        return agent if min(is_left.sum(), (~is_left).sum()) >= _MIN_VEHICLES else None

    def is_visible(self, scene: Actors, agent: int, ego: int) -> bool:
        """A corridor needs traffic on both sides."""
        is_near = np.abs(scene.positions - scene.positions[ego]).max(-1) < _VIEW
        is_near[[agent, ego]] = False
        left, right = is_near & (scene.lane == self._abreast[0]), is_near & np.isin(scene.lane, self._abreast[1:2])
        return bool(left.sum() >= _MIN_VEHICLES and right.sum() >= _MIN_VEHICLES)

    def _shift(self, lane: np.ndarray) -> np.ndarray:
        """Offsets to the left by which vehicles of lanes make way [m]."""
        return np.where(lane == self._abreast[0], _LEFT_SHIFT, _RIGHT_SHIFT)
