"""Cut-in: a vehicle that changes lanes closely ahead of another one."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import LEAD_TIME, MAX_RADIUS, StagedEvent, add_vehicles, remove_vehicles
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import TIME_STEP, Fleet, TrafficSimulation
from scjax.synthetic.traffic.fleet import vehicle_ids
from scjax.synthetic.traffic.lane_changes import start_change

_SPEEDS = (0.5, 0.9)  # of the speed of the lane
_GAPS = (4.0, 8.0)  # m to the follower at the start
_CHANGE_TIME = 4.0  # s; half of it has passed at the moment
_MIDDLE = (0.9, 2.0)  # m from the centerline of the new lane at the moment
_MAX_GAP = 12.0  # m to the follower at the moment
_MIN_FOLLOWER_SPEED = 2.0  # m/s
_JUNCTION_MARGIN = 16.0  # m around junctions without cut-ins
_CLEARANCE = 14.0  # m of both lanes without other vehicles
_ATTEMPTS = 4


class CutIn(StagedEvent):
    event = "cut-in"

    def __init__(self, *place):
        super().__init__(*place)
        lane = self.net.lanes[self.lane]
        target = lane.left if lane.left is not None else lane.right
        assert target is not None, "the lane has a neighbor"
        self._target = target
        self._wait = -1.0  # s until the change begins
        self._row = -1
        self._fleet: Fleet | None = None
        self._rng = np.random.default_rng(0)

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        return net.lanes[lane].left is not None or net.lanes[lane].right is not None

    @classmethod
    def draw(cls, net: Network, lanes: LaneArrays, rng: np.random.Generator) -> StagedEvent | None:
        for _ in range(_ATTEMPTS):
            event = super().draw(net, lanes, rng)
            if event is None:
                return None
            distances = [
                np.hypot(*(event.pose()[0][0] - junction.center)) - junction.radius for junction in net.junctions
            ]
            if min(distances, default=np.inf) > _JUNCTION_MARGIN:
                return event
        return None

    def start(self, simulation: TrafficSimulation, rng: np.random.Generator) -> None:
        super().start(simulation, rng)
        self._wait, self._row, self._rng = LEAD_TIME - _CHANGE_TIME / 2, -1, rng

    def step(self, simulation: TrafficSimulation) -> None:
        self._fleet = simulation.fleet
        if self._wait < 0:
            return
        self._wait -= TIME_STEP
        if self._wait < 0:
            self._begin(simulation)

    def _begin(self, simulation: TrafficSimulation) -> None:
        """Puts a vehicle and a follower in two neighboring lanes, and lets the first change lanes."""
        lanes, rng = self.lanes, self._rng
        gap = 5.0 + rng.uniform(*_GAPS)  # m between the centers
        own_limit = lanes.speed[self.lane]
        speed = min(rng.uniform(*_SPEEDS) * own_limit, (self.along - gap - 3.0) / (_CHANGE_TIME / 2))
        own = self.along - speed * _CHANGE_TIME / 2
        place = own * lanes.length[self._target] / lanes.length[self.lane]
        fleet = simulation.fleet
        low, high = own - gap - _CLEARANCE, own + _CLEARANCE
        in_way = np.isin(fleet.lane, [self.lane, self._target]) & (fleet.along > low) & (fleet.along < high)
        remove_vehicles(simulation, np.flatnonzero(in_way))
        self._row = len(fleet)
        simulation.fleet = add_vehicles(
            fleet,
            lanes,
            np.array([self.lane, self._target]),
            np.array([own, place - gap]),
            np.full(2, speed),
            np.array([speed / own_limit, rng.uniform(1.0, 1.2) * speed / lanes.speed[self._target]]),
            np.zeros(2),
            rng,
        )
        self._fleet = simulation.fleet
        start_change(self._fleet, lanes, self._row, self._target, place, rng, seconds=_CHANGE_TIME)

    def find(self, scene: Actors) -> int | None:
        fleet = self._fleet
        if self._row < 0 or fleet is None:
            return None
        row, follower = self._row, self._row + 1
        is_in_lane = fleet.lane[row] == self._target and fleet.lane[follower] == self._target
        gap = fleet.along[row] - fleet.along[follower] - (fleet.sizes[row, 0] + fleet.sizes[follower, 0]) / 2
        is_between = _MIDDLE[0] < abs(fleet.lateral[row]) < _MIDDLE[1]
        if not is_in_lane or not is_between or not 0 < gap < _MAX_GAP or fleet.speed[follower] < _MIN_FOLLOWER_SPEED:
            return None
        places = [
            np.flatnonzero((scene.ids == one) & (scene.types == AgentType.VEHICLE))
            for one in vehicle_ids(fleet, np.array([row, follower]))
        ]
        if not all(len(found) for found in places):
            return None
        agent = int(places[0][0])
        return agent if np.hypot(*scene.positions[agent]) < MAX_RADIUS else None
