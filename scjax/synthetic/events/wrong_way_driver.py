"""Wrong-way driver: a vehicle on a lane, against its direction."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import EventOutcome, StagedEvent, replace_near

_SPEEDS = (4, 12)  # m/s
_CLEAR_RADIUS = 6.0  # m without other agents


class WrongWayDriver(StagedEvent):
    event = "wrong-way driver"

    def apply(self, scene: Actors, rng: np.random.Generator) -> EventOutcome:
        position, heading = self.pose()
        speed, size = rng.uniform(*_SPEEDS), actors.draw_vehicle_sizes(1, rng, long=False)
        driver = actors.make_actors(AgentType.VEHICLE, position, heading + np.pi, speed, size, lane=self.lane)
        scene = replace_near(scene, driver, _CLEAR_RADIUS)
        return EventOutcome(scene, len(scene) - 1, self.event)
