"""Vehicles that block a lane: stopped in the lane, or double parked beside a parked vehicle."""

from __future__ import annotations

import numpy as np

from scjax.scene import TILE_SIZE, AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import MIN_CLEARANCE, StagedEvent, add_vehicles
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import Fleet

_SPEED_FACTOR = 1e-3  # of a vehicle that does not move
_STOPPED_SPEED = 0.1  # m/s
_MAX_DISTANCE = 2.0  # m between the event and the vehicle that blocks the lane
_CLEAR_DISTANCE = 12.0  # m along the lane without other vehicles at the start
_EDGE_DISTANCE = 0.9  # m from a double-parked vehicle's center to the edge of its lane
_LEADER_LATERAL = 1.8  # m
_CAUSE_DISTANCE = 15.0  # m ahead of a stopped vehicle that a scene has to show, as far as a cause may lie
_HALF_WINDOW = TILE_SIZE / 2  # m


class StoppedVehicle(StagedEvent):
    event = "stopped-in-lane"

    def prepare_traffic(self, fleet: Fleet, rng: np.random.Generator) -> Fleet:
        return self._block(fleet, rng.normal(0, 0.15), rng)

    def find(self, scene: Actors) -> int | None:
        """None if the vehicle is missing or a lead vehicle explains the stop."""
        position, _ = self.pose()
        distance = np.hypot(*(scene.positions - position).T)
        is_stopped = (scene.lane == self.lane) & (scene.speeds < _STOPPED_SPEED) & (scene.types == AgentType.VEHICLE)
        vehicles = np.flatnonzero(is_stopped & (distance < _MAX_DISTANCE))
        return None if not len(vehicles) or _has_leader(scene, int(vehicles[0])) else int(vehicles[0])

    def is_visible(self, scene: Actors, agent: int, ego: int) -> bool:
        """A scene shows that nothing is ahead of the vehicle if its window holds the road there."""
        heading, ego_heading = scene.headings[agent], scene.headings[ego]
        offset = scene.positions[agent] - scene.positions[ego]
        offset = offset + _CAUSE_DISTANCE * np.array([np.cos(heading), np.sin(heading)])
        along = np.cos(ego_heading) * offset[0] + np.sin(ego_heading) * offset[1]
        left = np.cos(ego_heading) * offset[1] - np.sin(ego_heading) * offset[0]
        return bool(max(abs(along), abs(left)) < _HALF_WINDOW)

    def _block(self, fleet: Fleet, lateral: float, rng: np.random.Generator) -> Fleet:
        """The fleet with a vehicle that does not move, at ``lateral`` to the left of the centerline [m]."""
        is_kept = (fleet.lane != self.lane) | (np.abs(fleet.along - self.along) > _CLEAR_DISTANCE)
        lane, along, factor = np.array([self.lane]), np.array([self.along]), np.array([_SPEED_FACTOR])
        return add_vehicles(
            fleet.select(is_kept), self.lanes, lane, along, np.zeros(1), factor, np.array([lateral]), rng
        )


class DoubleParking(StoppedVehicle):
    """A vehicle that stops at the edge of its lane, beside a parked one."""

    event = "double-parking"

    def __init__(self, *place):
        super().__init__(*place)
        self._parked = actors.no_actors()

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        one = net.lanes[lane]
        is_narrow = one.at_curb and one.left is None
        return (is_narrow or lane in net.parking_lanes) and one.subtype != "freeway"

    def prepare_traffic(self, fleet: Fleet, rng: np.random.Generator) -> Fleet:
        lateral = -(0.5 * self.net.lanes[self.lane].width - _EDGE_DISTANCE)
        position, heading = self.pose()
        right = np.stack([np.sin(heading), -np.cos(heading)], -1)
        along, beside = rng.uniform(-2, 2), -lateral + rng.uniform(2.3, 2.6)
        position = position + along * np.stack([-right[:, 1], right[:, 0]], -1) + beside * right
        size = actors.draw_vehicle_sizes(1, rng, long=False)
        self._parked = self.with_ids(actors.make_actors(AgentType.VEHICLE, position, heading, 0.0, size))
        return self._block(fleet, lateral, rng)

    def actors(self) -> Actors:
        return self._parked

    def is_visible(self, scene: Actors, agent: int, ego: int) -> bool:
        del scene, agent, ego
        return True


def _has_leader(scene: Actors, agent: int) -> bool:
    """Whether a lead vehicle explains why ``agent`` stands."""
    offset, heading = scene.positions - scene.positions[agent], scene.headings[agent]
    along = np.cos(heading) * offset[:, 0] + np.sin(heading) * offset[:, 1]
    left = np.cos(heading) * offset[:, 1] - np.sin(heading) * offset[:, 0]
    return bool(((along > 1.0) & (along < MIN_CLEARANCE) & (np.abs(left) < _LEADER_LATERAL)).any())
