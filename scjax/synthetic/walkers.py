"""People and cyclists who move along lanes, beside traffic."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network

_RIDES, _RIDE_SPACING = 0.08, 3.6  # share of cyclists who lead a group; m between its members


@dataclasses.dataclass(frozen=True)
class LaneWalkers:
    """Agents of one type along lanes, arrays [agents].

    Attributes:
      agent_type: of all of them.
      lane: index of the lane.
      start: position along the lane at time 0 [m].
      speed: along the lane, negative against it [m/s].
      right: offset to the right of the centerline [m].
      sizes: length, width, height [m].
    """

    agent_type: AgentType
    lane: Int[np.ndarray, " n"]
    start: Float64[np.ndarray, " n"]
    speed: Float64[np.ndarray, " n"]
    right: Float64[np.ndarray, " n"]
    sizes: Float64[np.ndarray, "n 3"]

    def at(self, lanes: LaneArrays, time: float) -> Actors:
        """The agents at ``time`` [s]. At the end of its lane an agent leaves, and another one comes at the start."""
        if not len(self.lane):
            return actors.no_actors()
        laps, along = np.divmod(self.start + self.speed * time, lanes.length[self.lane])
        positions, headings = lanes.poses_at(self.lane, along)
        positions = positions + self.right[:, None] * np.stack([np.sin(headings), -np.cos(headings)], -1)
        headings = headings + np.pi * (self.speed < 0)
        made = actors.make_actors(self.agent_type, positions, headings, np.abs(self.speed), self.sizes)
        made.ids = (int(self.agent_type) + 1) * 10**9 + 1000 * np.arange(len(made)) + np.mod(laps.astype(int), 1000)
        return made


def draw_pedestrians(net: Network, lanes: LaneArrays, density: float, rng: np.random.Generator) -> LaneWalkers:
    """Groups of one to four pedestrians on sidewalks; ``density`` is groups per 100 m."""
    rows = []
    for lane in net.sidewalk_lanes:
        for _ in range(rng.poisson(density * lanes.length[lane] / 100)):
            group = 1 + int(rng.geometric(0.65) - 1)
            start, right = rng.uniform(0, lanes.length[lane]), 0.5 * net.lanes[lane].width + rng.uniform(1.2, 4.5)
            speed = float(rng.choice([-1, 1]) * _draw_walking_speed(rng))
            rows += [(lane, start + rng.normal(0, 0.8), speed, right + 0.9 * k) for k in range(min(group, 4))]
    return _lane_walkers(AgentType.PEDESTRIAN, rows, rng)


def draw_cyclists(net: Network, lanes: LaneArrays, density: float, rng: np.random.Generator) -> LaneWalkers:
    """Cyclists at the right edge of lanes; ``density`` is cyclists per 100 m."""
    rows = []
    for k, lane in enumerate(net.lanes):
        if not lane.at_curb or lane.subtype == "freeway" or lane.height != 0.0:
            continue
        for _ in range(rng.poisson(density * lanes.length[k] / 100)):
            right, start = 0.5 * lane.width - rng.uniform(0.2, 0.6), rng.uniform(0, lanes.length[k])
            speed = rng.gamma(6.0, 0.7)
            group = int(rng.integers(2, 6)) if rng.random() < _RIDES else 1
            rows += [(k, start + number * _RIDE_SPACING, speed, right) for number in range(group)]
    return _lane_walkers(AgentType.CYCLIST, rows, rng)


def _lane_walkers(agent_type: AgentType, rows: list[tuple], rng: np.random.Generator) -> LaneWalkers:
    """``rows``: lane, start, speed, right of every agent."""
    table = np.array(rows, float).reshape(-1, 4)
    sizes = actors.draw_sizes(agent_type, len(table), rng)
    return LaneWalkers(agent_type, table[:, 0].astype(int), table[:, 1], table[:, 2], table[:, 3], sizes)


def _draw_walking_speed(rng: np.random.Generator) -> float:
    """Speed of a pedestrian on a sidewalk [m/s]: a quarter stand, a quarter stroll, the others walk."""
    share = rng.random()
    return rng.uniform(0, 0.2) if share < 0.25 else rng.uniform(0.2, 0.9) if share < 0.5 else rng.normal(1.15, 0.28)
