"""Vehicles that block a lane: stopped in the lane, or double parked beside a parked vehicle."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import MIN_CLEARANCE, EventOutcome, StagedEvent, replace_vehicles
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import Fleet

_SPEED_FACTOR = 1e-3  # of a vehicle that does not move
_STOPPED_SPEED = 0.1  # m/s
_MAX_DISTANCE = 2.0  # m between the event and the vehicle that blocks the lane
_CLEAR_DISTANCE = 12.0  # m along the lane without other vehicles at the start
_EDGE_DISTANCE = 0.9  # m from a double-parked vehicle's center to the edge of its lane
_LEADER_LATERAL = 1.8  # m


class StoppedVehicle(StagedEvent):
    event = "stopped vehicle in lane"

    def prepare_traffic(self, fleet: Fleet, rng: np.random.Generator) -> Fleet:
        return self._block(fleet, rng.normal(0, 0.15), rng)

    def apply(self, scene: Actors, rng: np.random.Generator) -> EventOutcome | None:
        agent = self._find_blocking_vehicle(scene)
        return None if agent is None else EventOutcome(scene, agent, self.event)

    def _block(self, fleet: Fleet, lateral: float, rng: np.random.Generator) -> Fleet:
        """The fleet with a vehicle that does not move, at ``lateral`` to the left of the centerline [m]."""
        is_kept = (fleet.lane != self.lane) | (np.abs(fleet.along - self.along) > _CLEAR_DISTANCE)
        lane, along, factor = np.array([self.lane]), np.array([self.along]), np.array([_SPEED_FACTOR])
        return replace_vehicles(fleet, is_kept, self.lanes, lane, along, factor, lateral, rng)

    def _find_blocking_vehicle(self, scene: Actors) -> int | None:
        """Index of the vehicle; None if it is missing or a lead vehicle explains the stop."""
        position, _ = self.pose()
        distance = np.hypot(*(scene.positions - position).T)
        is_stopped = (scene.lane == self.lane) & (scene.speeds < _STOPPED_SPEED)
        vehicles = np.flatnonzero(is_stopped & (distance < _MAX_DISTANCE))
        return None if not len(vehicles) or _has_leader(scene, int(vehicles[0])) else int(vehicles[0])


class DoubleParking(StoppedVehicle):
    """A vehicle that stops at the edge of its lane, with a parked vehicle beside it if there is room for one."""

    event = "double parking"

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        is_single = net.lanes[lane].left is None and net.lanes[lane].subtype != "freeway"
        return lane in net.parking_lanes and is_single

    def prepare_traffic(self, fleet: Fleet, rng: np.random.Generator) -> Fleet:
        return self._block(fleet, -(0.5 * self.net.lanes[self.lane].width - _EDGE_DISTANCE), rng)

    def apply(self, scene: Actors, rng: np.random.Generator) -> EventOutcome | None:
        """Without a parked vehicle beside it, the vehicle is a stopped one."""
        agent = self._find_blocking_vehicle(scene)
        if agent is None:
            return None
        scene = _add_parked_beside(scene, agent, rng)
        event = self.event if _has_parked_beside(scene, agent) else StoppedVehicle.event
        return EventOutcome(scene, agent, event)


def _has_leader(scene: Actors, agent: int) -> bool:
    """Whether a lead vehicle explains why ``agent`` stands."""
    offset, heading = scene.positions - scene.positions[agent], scene.headings[agent]
    along = np.cos(heading) * offset[:, 0] + np.sin(heading) * offset[:, 1]
    left = np.cos(heading) * offset[:, 1] - np.sin(heading) * offset[:, 0]
    return bool(((along > 1.0) & (along < MIN_CLEARANCE) & (np.abs(left) < _LEADER_LATERAL)).any())


def _has_parked_beside(scene: Actors, agent: int) -> bool:
    offset = scene.positions - scene.positions[agent]
    heading = scene.headings[agent]
    right = np.sin(heading) * offset[:, 0] - np.cos(heading) * offset[:, 1]
    parked = (scene.types == AgentType.VEHICLE) & (scene.lane < 0) & (scene.speeds < _STOPPED_SPEED)
    return bool((parked & (np.hypot(*offset.T) < 8.0) & (right > 1.0)).any())


def _add_parked_beside(scene: Actors, agent: int, rng: np.random.Generator) -> Actors:
    """The scene with a vehicle parked at the curb beside ``agent``, if there is room for it."""
    heading = scene.headings[agent]
    right = np.array([np.sin(heading), -np.cos(heading)])
    along, lateral = rng.uniform(-2, 2), rng.uniform(2.3, 2.6)
    position = scene.positions[agent] + along * np.array([-right[1], right[0]]) + lateral * right
    size = actors.draw_vehicle_sizes(1, rng, long=False)
    parked = actors.make_actors(AgentType.VEHICLE, position[None], heading, 0.0, size)
    combined = actors.concatenate_actors([scene, parked])
    return scene if (actors.overlapping_actors(combined)[:, 1] == len(scene)).any() else combined
