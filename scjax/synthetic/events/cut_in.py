"""Cut-in: a vehicle halfway into the neighboring lane, closely ahead of a vehicle that drives there."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import MAX_RADIUS, EventOutcome, StagedEvent
from scjax.synthetic.network import Network

_MIN_FOLLOWER_SPEED = 3.0  # m/s
_GAPS = (3.0, 7.0)  # m to the follower
_LATERAL = (0.9, 1.6)  # m from the centerline of the target lane
_ANGLES = (0.06, 0.16)  # rad towards the target lane
_JUNCTION_MARGIN = 16.0  # m around junctions without cut-ins
_BOX_MARGIN = 0.4  # m to other agents


class CutIn(StagedEvent):
    event = "cut-in"

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        return net.lanes[lane].left is not None or net.lanes[lane].right is not None

    def apply(self, scene: Actors, rng: np.random.Generator) -> EventOutcome | None:
        lane = self.net.lanes[self.lane]
        target_lane, side = (lane.left, 1.0) if lane.left is not None else (lane.right, -1.0)
        is_vehicle = scene.types == AgentType.VEHICLE
        followers = np.flatnonzero((scene.lane == target_lane) & (scene.speeds > _MIN_FOLLOWER_SPEED) & is_vehicle)
        rng.shuffle(followers)
        for follower in followers:
            heading = scene.headings[follower]
            ahead = np.array([np.cos(heading), np.sin(heading)])
            left = np.array([-ahead[1], ahead[0]])
            size = actors.draw_vehicle_sizes(1, rng, long=False)
            gap = (scene.sizes[follower, 0] + size[0, 0]) / 2 + rng.uniform(*_GAPS)
            position = scene.positions[follower] + gap * ahead - side * rng.uniform(*_LATERAL) * left
            if np.hypot(*position) > MAX_RADIUS or self._is_near_junction(position):
                continue
            new_heading = heading + side * rng.uniform(*_ANGLES)
            speed = scene.speeds[follower] * rng.uniform(0.85, 1.05)
            vehicle = actors.make_actors(AgentType.VEHICLE, position[None], new_heading, speed, size, lane=self.lane)
            combined = actors.concatenate_actors([scene, vehicle])
            pairs = actors.overlapping_actors(combined, _BOX_MARGIN)
            in_the_way = np.unique(pairs[pairs[:, 1] == len(combined) - 1, 0])
            if follower in in_the_way:
                continue
            remaining = np.setdiff1d(np.arange(len(combined)), in_the_way)
            return EventOutcome(combined.select(remaining), len(remaining) - 1, self.event)
        return None

    def _is_near_junction(self, position: np.ndarray) -> bool:
        return any(
            np.hypot(*(position - junction.center)) < junction.radius + _JUNCTION_MARGIN
            for junction in self.net.junctions
        )
