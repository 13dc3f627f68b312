"""Protocol of a rare event in a synthetic world: where it fits, what it does to traffic, how it moves."""

from __future__ import annotations

import abc
from typing import ClassVar

import numpy as np

from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import Fleet, Obstacle, TrafficSimulation, make_fleet

MIN_CLEARANCE = 22.0  # m of lane before an event, and after it
MAX_RADIUS = 75.0  # m from the origin to an event
LEAD_TIME = 3.0  # s from the start of an event to the moment that shows it
_MIN_LANE_MARGIN = 15.0  # m
_POSITIONS_PER_LANE = 3
_AHEAD_OF_TRAFFIC = (8.0, 18.0)  # m
STAGED_IDS = 6 * 10**9  # from here on, of agents that are no part of traffic


class StagedEvent(abc.ABC):
    """An event at a place of a network.

    The world calls ``prepare_traffic`` before the simulation, ``start`` ``LEAD_TIME`` before every moment, ``step``
    before every step, and ``find`` at the moment.

    Attributes:
      event: its name.
      clearance: distance to egos whose scenes do not show the event [m].
      net, lanes: the network.
      candidates: lanes where the event may happen.
      lane: index of the lane where the event happens.
      along: position along the lane [m].
      number: how often it has started.
    """

    event: ClassVar[str]
    clearance: ClassVar[float] = 50.0

    def __init__(self, net: Network, lanes: LaneArrays, candidates: list[int], lane: int, along: float):
        self.net, self.lanes, self.candidates, self.lane, self.along = net, lanes, candidates, lane, along
        self.number = 0

    @classmethod
    def draw(cls, net: Network, lanes: LaneArrays, rng: np.random.Generator) -> StagedEvent | None:
        """A random place near the origin, on a lane that is no connector; None where the network has none."""
        min_length = 2 * MIN_CLEARANCE + _MIN_LANE_MARGIN
        candidates = [
            k
            for k, lane in enumerate(net.lanes)
            if lane.junction < 0 and lane.height == 0.0 and lanes.length[k] > min_length and cls.fits(net, k)
        ]
        rng.shuffle(candidates)
        for lane in candidates:
            for along in rng.uniform(MIN_CLEARANCE, lanes.length[lane] - MIN_CLEARANCE, _POSITIONS_PER_LANE):
                position, _ = lanes.poses_at(np.array([lane]), np.array([along]))
                if np.hypot(*position[0]) < MAX_RADIUS:
                    return cls(net, lanes, candidates, int(lane), float(along))
        return None

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        """Whether the event can happen on a lane."""
        del net, lane
        return True

    def prepare_traffic(self, fleet: Fleet, rng: np.random.Generator) -> Fleet:
        """The fleet with the vehicles that the event needs from the start."""
        del rng
        return fleet

    def start(self, simulation: TrafficSimulation, rng: np.random.Generator) -> None:
        """Begins the event; its moment comes in ``LEAD_TIME``."""
        del simulation, rng
        self.number += 1

    def step(self, simulation: TrafficSimulation) -> None:
        """Moves the event on by ``TIME_STEP``; the traffic has not moved yet."""
        del simulation

    def obstacles(self) -> tuple[Obstacle, ...]:
        """What traffic keeps behind now."""
        return ()

    def actors(self) -> Actors:
        """The agents that are no part of traffic, now."""
        return actors.no_actors()

    @abc.abstractmethod
    def find(self, scene: Actors) -> int | None:
        """Index of the agent that the event is about in a scene at its moment; None if it does not show the event."""

    def is_visible(self, scene: Actors, agent: int, ego: int) -> bool:
        """Whether the scene around ``ego`` shows the whole event; ``agent`` is the one that the event is about."""
        del scene, agent, ego
        return True

    def move_near_traffic(self, simulation: TrafficSimulation, rng: np.random.Generator) -> None:
        """Puts the event ahead of a vehicle in one of the lanes where it may happen, so that somebody sees it."""
        fleet, lanes = simulation.fleet, self.lanes
        rows = np.flatnonzero(np.isin(fleet.lane, self.candidates))
        ahead = fleet.along[rows] + 0.7 * LEAD_TIME * fleet.speed[rows] + rng.uniform(*_AHEAD_OF_TRAFFIC, len(rows))
        is_inside = (ahead > MIN_CLEARANCE) & (ahead < lanes.length[fleet.lane[rows]] - MIN_CLEARANCE)
        rows, ahead = rows[is_inside], ahead[is_inside]
        positions, _ = lanes.poses_at(fleet.lane[rows], ahead)
        near = np.flatnonzero(np.hypot(*positions.T) < MAX_RADIUS)
        if len(near):
            chosen = int(rng.choice(near))
            self.lane, self.along = int(fleet.lane[rows[chosen]]), float(ahead[chosen])

    def pose(self, along: float | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Position [1, 2] in m and heading [1] in rad of the event, or at ``along`` in its lane [m]."""
        return self.lanes.poses_at(np.array([self.lane]), np.array([self.along if along is None else along]))

    def find_staged(self, scene: Actors, number: int = 0) -> int | None:
        """Index in a scene of agent ``number`` of ``actors()``; None if it is not there."""
        rows = np.flatnonzero(scene.ids == self._ids(number + 1)[number])
        return int(rows[0]) if len(rows) else None

    def with_ids(self, agents: Actors) -> Actors:
        """The agents of the event with their numbers."""
        agents.ids = self._ids(len(agents))
        return agents

    def _ids(self, count: int) -> np.ndarray:
        return STAGED_IDS + 1000 * self.number + np.arange(count)


def add_vehicles(
    fleet: Fleet,
    lanes: LaneArrays,
    lane: np.ndarray,
    along: np.ndarray,
    speed: np.ndarray,
    speed_factor: np.ndarray,
    lateral: np.ndarray,
    rng: np.random.Generator,
) -> Fleet:
    """The fleet with new vehicles, none of them long, at positions ``along`` [m] of lanes."""
    sizes = actors.draw_vehicle_sizes(len(lane), rng, long=False)
    return fleet.extend(make_fleet(lanes, lane, along, speed, sizes, speed_factor, lateral, rng))


def remove_vehicles(simulation: TrafficSimulation, rows: np.ndarray) -> None:
    """Takes vehicles (indices in the fleet) off the map; they enter it again later."""
    fleet = simulation.fleet
    simulation.right_of_way.release(fleet, rows[fleet.granted[rows] >= 0])
    fleet.lane[rows] = -1
