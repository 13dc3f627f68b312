"""Work zone: cones and barriers that close a lane, or stand along the edge of a road with one lane."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import StagedEvent
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import Fleet, Obstacle

_TAPER, _LENGTHS = 12.0, (10.0, 26.0)  # m over which the cones close the lane, and of the closed part
_SPACING = 3.0  # m between cones
_EDGE = 0.35  # m from the cones to the edge of the lane that stays open
_BEFORE = 3.0  # m before the first cone where vehicles stop
_NUMBER_SEEN = 4  # cones near the ego in a scene that shows the work zone
_VIEW = 26.0  # m


class WorkZone(StagedEvent):
    event = "work-zone"

    def __init__(self, *place):
        super().__init__(*place)
        self._objects = actors.no_actors()
        lane = self.net.lanes[self.lane]
        self._closes_lane = lane.left is not None or lane.right is not None

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        """A lane at the edge of the road: one of several lanes is closed, or the edge of the only one is taken."""
        one = net.lanes[lane]
        return (one.left is None or one.right is None) and lane not in net.parking_lanes

    def prepare_traffic(self, fleet: Fleet, rng: np.random.Generator) -> Fleet:
        width = self.net.lanes[self.lane].width
        length = min(float(rng.uniform(*_LENGTHS)), self.lanes.length[self.lane] - self.along - 6.0)
        along = np.arange(0.0, _TAPER + length, _SPACING)
        if self._closes_lane:
            side = 1.0 if self.net.lanes[self.lane].left is not None else -1.0  # of the open lane, to the left
            share = np.clip(along / _TAPER, 0.0, 1.0)
            lateral = side * ((width / 2 - _EDGE) * (2 * share - 1))
        else:
            lateral = np.full(len(along), -(width / 2 + rng.uniform(0.2, 0.5)))
        positions, headings = self.lanes.poses_at(np.full(len(along), self.lane), self.along + along)
        positions = positions + lateral[:, None] * np.stack([-np.sin(headings), np.cos(headings)], -1)
        is_barrier = np.zeros(len(along), bool)
        if rng.random() < 0.5:
            is_barrier = along >= _TAPER
        sizes = np.where(is_barrier[:, None], actors.BARRIER_SIZE, actors.CONE_SIZE)
        self._objects = self.with_ids(actors.make_actors(AgentType.STATIC, positions, headings, 0.0, sizes))
        if not self._closes_lane:
            return fleet
        end = self.along + _TAPER + length
        inside = (fleet.lane == self.lane) & (fleet.along > self.along - 15.0) & (fleet.along < end + 3.0)
        return fleet.select(~inside)

    def obstacles(self) -> tuple[Obstacle, ...]:
        return (Obstacle(self.lane, self.along - _BEFORE),) if self._closes_lane else ()

    def actors(self) -> Actors:
        return self._objects

    def find(self, scene: Actors) -> int | None:
        return self.find_staged(scene, min(len(self._objects) - 1, int(_TAPER / _SPACING)))

    def find_staged(self, scene: Actors, number: int = 0) -> int | None:
        rows = np.flatnonzero(scene.ids == self._objects.ids[number])
        return int(rows[0]) if len(rows) else None

    def is_visible(self, scene: Actors, agent: int, ego: int) -> bool:
        del agent
        is_object = np.isin(scene.ids, self._objects.ids)
        return int((np.abs(scene.positions[is_object] - scene.positions[ego]).max(-1) < _VIEW).sum()) >= _NUMBER_SEEN
