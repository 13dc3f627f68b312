"""Protocol of a rare event in a synthetic world: where it fits, what it needs in traffic, how it looks in a scene."""

from __future__ import annotations

import abc
import dataclasses
from typing import ClassVar, NamedTuple

import numpy as np

from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import Fleet

MIN_CLEARANCE = 22.0  # m of lane before an event, and after it
MAX_RADIUS = 75.0  # m from the origin to an event
_MIN_LANE_MARGIN = 15.0  # m
_POSITIONS_PER_LANE = 3


class EventOutcome(NamedTuple):
    """A scene with an event: all agents, the index of the agent that the event is about, and the event's name."""

    scene: Actors
    agent: int
    event: str


@dataclasses.dataclass(frozen=True)
class StagedEvent(abc.ABC):
    """An event at a place of a network.

    The world calls ``prepare_traffic`` before the simulation and ``apply`` at every moment.

    Attributes:
      net, lanes: the network.
      lane: index of the lane where the event happens.
      along: position along the lane [m].
    """

    event: ClassVar[str]
    net: Network
    lanes: LaneArrays
    lane: int
    along: float

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
                    return cls(net, lanes, int(lane), float(along))
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

    @abc.abstractmethod
    def apply(self, scene: Actors, rng: np.random.Generator) -> EventOutcome | None:
        """The scene of one moment with the event; None without room for it."""

    def is_visible(self, scene: Actors, agent: int, ego: int) -> bool:
        """Whether the scene around ``ego`` shows the whole event; ``agent`` is the one that the event is about."""
        del scene, agent, ego
        return True

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [1, 2] in m and heading [1] in rad of the event."""
        return self.lanes.poses_at(np.array([self.lane]), np.array([self.along]))


def replace_vehicles(
    fleet: Fleet,
    is_kept: np.ndarray,
    lanes: LaneArrays,
    lane: np.ndarray,
    along: np.ndarray,
    speed_factor: np.ndarray,
    lateral: float,
    rng: np.random.Generator,
) -> Fleet:
    """The vehicles ``is_kept`` of a fleet, and new ones that start at rest at positions ``along`` [m] of lanes."""
    new = {
        "lane": lane,
        "along": along,
        "speed": np.zeros(len(lane)),
        "next_lane": lanes.successors[lane, 0],
        "granted": np.full(len(lane), -1),
        "sizes": actors.draw_vehicle_sizes(len(lane), rng, long=False),
        "speed_factor": speed_factor,
        "lateral": np.full(len(lane), lateral),
    }
    return Fleet(**{name: np.concatenate([getattr(fleet, name)[is_kept], value]) for name, value in new.items()})


def replace_near(scene: Actors, new: Actors, radius: float) -> Actors:
    """The scene with one new agent at the end, without the agents within ``radius`` [m] of it."""
    is_near = np.hypot(*(scene.positions - new.positions).T) < radius
    return actors.concatenate_actors([scene.select(~is_near), new])
