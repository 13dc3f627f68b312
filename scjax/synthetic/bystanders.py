"""Agents that do not take part in traffic: what stands beside it, people, and cyclists."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.crosswalks import CrosswalkWalkers, find_crosswalks
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network
from scjax.synthetic.standing import draw_standing
from scjax.synthetic.traffic.right_of_way import RightOfWay
from scjax.synthetic.walkers import LaneWalkers, draw_cyclists, draw_pedestrians

_CROSSING_SHARE, _MAX_CROSSING = 0.6, 1.5  # people for each crosswalk, of the density on sidewalks
_CROWD_SHARE, _CROWD = 0.12, (3.5, 7.0)  # of worlds with pedestrians; people for each crosswalk


@dataclasses.dataclass
class Bystanders:
    """Standing agents, pedestrians along lanes and on crosswalks, and cyclists along lanes."""

    standing: Actors
    pedestrians: LaneWalkers
    cyclists: LaneWalkers
    crossing: CrosswalkWalkers

    def step(self, seconds: float, way: RightOfWay) -> None:
        """Lets people on crosswalks walk for ``seconds``; they and vehicles yield by ``way``."""
        self.crossing.step(seconds, way)

    def at(self, lanes: LaneArrays, time: float) -> Actors:
        """All bystanders; ``time`` is that of the last step [s]."""
        groups = [self.standing, self.pedestrians.at(lanes, time), self.cyclists.at(lanes, time)]
        return actors.concatenate_actors([*groups, self.crossing.actors()])


def draw_bystanders(
    net: Network, lanes: LaneArrays, pedestrian_density: float, cyclist_density: float, rng: np.random.Generator
) -> Bystanders:
    """Random bystanders of a world.

    Args:
      pedestrian_density: mean groups of pedestrians per 100 m of sidewalk.
      cyclist_density: mean cyclists per 100 m of lane at the curb.
    """
    num_crossing = min(_CROSSING_SHARE * pedestrian_density, _MAX_CROSSING)
    if pedestrian_density > 0 and rng.random() < _CROWD_SHARE:
        num_crossing = rng.uniform(*_CROWD)
    standing = draw_standing(net, lanes, pedestrian_density > 0, rng)
    standing.ids = 5 * 10**9 + np.arange(len(standing))
    return Bystanders(
        standing,
        draw_pedestrians(net, lanes, pedestrian_density, rng),
        draw_cyclists(net, lanes, cyclist_density, rng),
        CrosswalkWalkers(find_crosswalks(net), num_crossing, rng),
    )
