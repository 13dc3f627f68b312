"""Jaywalker: a pedestrian who crosses a lane away from junctions."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import EventOutcome, StagedEvent, replace_near
from scjax.synthetic.network import Network

_SPEEDS = (1.0, 2.2)  # m/s
_MAX_LATERAL = 0.8  # m from the centerline
_CLEAR_RADIUS = 3.0  # m without other agents


class Jaywalker(StagedEvent):
    event = "jaywalker"

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        return net.lanes[lane].subtype != "freeway"

    def apply(self, scene: Actors, rng: np.random.Generator) -> EventOutcome:
        position, lane_heading = self.pose()
        heading = lane_heading + rng.choice([-1, 1]) * np.pi / 2 + rng.normal(0, 0.2)
        left = np.stack([-np.sin(lane_heading), np.cos(lane_heading)], -1)
        position = position + rng.uniform(-_MAX_LATERAL, _MAX_LATERAL) * left
        size, speed = actors.draw_sizes(AgentType.PEDESTRIAN, 1, rng), rng.uniform(*_SPEEDS)
        walker = actors.make_actors(AgentType.PEDESTRIAN, position, heading, speed, size, lane=self.lane)
        scene = replace_near(scene, walker, _CLEAR_RADIUS)
        return EventOutcome(scene, len(scene) - 1, self.event)
