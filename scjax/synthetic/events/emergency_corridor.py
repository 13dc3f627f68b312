"""Emergency corridor: a jam that makes way for an ambulance between two lanes."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.events.base import EventOutcome, StagedEvent, replace_vehicles
from scjax.synthetic.network import Network
from scjax.synthetic.traffic import Fleet

_VEHICLES_PER_LANE = 9
_SPACING = (8.5, 11.0)  # m between vehicles of the jam
_SPEED_FACTORS = (0.02, 0.08)
_MIN_END_DISTANCE = 4.0  # m from a vehicle to the ends of its lane
_LEFT_SHIFT, _RIGHT_SHIFT = 0.85, -0.75  # m to the left, of the vehicles in the leftmost lane and in the others
_AMBULANCE_SIZE = (5.6, 2.0, 2.6)  # m
_MIN_VEHICLES = 2  # on either side
_VIEW = 22.0  # m


class EmergencyCorridor(StagedEvent):
    event = "emergency corridor"

    @classmethod
    def fits(cls, net: Network, lane: int) -> bool:
        """The rightmost of several lanes."""
        return net.lanes[lane].left is not None and net.lanes[lane].right is None

    def prepare_traffic(self, fleet: Fleet, rng: np.random.Generator) -> Fleet:
        """The fleet with a jam on all lanes abreast."""
        abreast = self.net.lanes_abreast(self.lane)
        is_kept = ~np.isin(fleet.lane, abreast)
        lane = np.repeat(abreast, _VEHICLES_PER_LANE)
        number = np.tile(np.arange(_VEHICLES_PER_LANE), len(abreast)) - _VEHICLES_PER_LANE // 2
        along = self.along + number * rng.uniform(*_SPACING)
        fits = (along > _MIN_END_DISTANCE) & (along < self.lanes.length[lane] - _MIN_END_DISTANCE)
        lane, along = lane[fits], along[fits] + rng.uniform(-0.8, 0.8, fits.sum())
        speed_factor = rng.uniform(*_SPEED_FACTORS, len(lane))
        return replace_vehicles(fleet, is_kept, self.lanes, lane, along, speed_factor, 0.0, rng)

    def apply(self, scene: Actors, rng: np.random.Generator) -> EventOutcome | None:
        abreast = self.net.lanes_abreast(self.lane)
        queued = np.isin(scene.lane, abreast) & (scene.types == AgentType.VEHICLE)
        is_left = scene.lane[queued] == abreast[0]
        if is_left.sum() < _MIN_VEHICLES or (~is_left).sum() < _MIN_VEHICLES:
            return None
        shift = np.where(scene.lane == abreast[0], _LEFT_SHIFT, _RIGHT_SHIFT) * queued
        left = np.stack([-np.sin(scene.headings), np.cos(scene.headings)], -1)
        shifted = dataclasses.replace(scene, positions=scene.positions + shift[:, None] * left)
        position, heading = self.lanes.poses_at(np.array([abreast[0]]), np.array([self.along]))
        right = np.stack([np.sin(heading), -np.cos(heading)], -1)
        position = position + 0.5 * self.net.lanes[abreast[0]].width * right
        ambulance = actors.make_actors(
            AgentType.VEHICLE, position, heading, rng.uniform(3, 8), _AMBULANCE_SIZE, lane=abreast[0]
        )
        combined = actors.concatenate_actors([shifted, ambulance])
        # Vehicles in the way of the ambulance, and those that overlap a shifted vehicle, are left out.
        first, second = actors.overlapping_actors(combined).T
        removed = np.where(second == len(combined) - 1, first, second)
        remaining = np.setdiff1d(np.arange(len(combined)), removed)
        return EventOutcome(combined.select(remaining), len(remaining) - 1, self.event)

    def is_visible(self, scene: Actors, agent: int, ego: int) -> bool:
        """A corridor needs traffic on both sides."""
        abreast = self.net.lanes_abreast(int(scene.lane[agent]))
        is_near = np.abs(scene.positions - scene.positions[ego]).max(-1) < _VIEW
        is_near[[agent, ego]] = False
        left, right = is_near & (scene.lane == abreast[0]), is_near & np.isin(scene.lane, abreast[1:2])
        return bool(left.sum() >= _MIN_VEHICLES and right.sum() >= _MIN_VEHICLES)
