"""Agents that do not take part in traffic: parked vehicles, pedestrians, cyclists, cones and barriers."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from scjax.scene import AgentType, Signal
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network

_BAY_WIDTH = 2.8  # m of a parking row per vehicle
_CROSSWALK_APPROACH = 6.0  # m that pedestrians walk before and after a crosswalk


class Crosswalk(NamedTuple):
    """A crossing in one direction: start and end [m], and the through connectors that it crosses."""

    start: np.ndarray
    end: np.ndarray
    connectors: list[int]


@dataclasses.dataclass
class LaneWalker:
    """A pedestrian or cyclist along a lane.

    Attributes:
      lane: index of the lane.
      start: position along the lane at time 0 [m].
      speed: along the lane, negative against it [m/s].
      right: offset to the right of the centerline [m].
    """

    lane: int
    start: float
    speed: float
    right: float


@dataclasses.dataclass
class CrosswalkWalker:
    """A pedestrian on a crosswalk; attributes as in ``LaneWalker``, positions along the crosswalk."""

    crosswalk: Crosswalk
    start: float
    speed: float
    right: float


@dataclasses.dataclass
class Bystanders:
    """Static agents, pedestrians along lanes and on crosswalks, and cyclists along lanes."""

    static: Actors
    pedestrians: list[LaneWalker]
    crossing_pedestrians: list[CrosswalkWalker]
    cyclists: list[LaneWalker]


def draw_bystanders(
    net: Network, lanes: LaneArrays, pedestrian_density: float, cyclist_density: float, rng: np.random.Generator
) -> Bystanders:
    """Random bystanders of a world.

    Args:
      pedestrian_density: mean groups of pedestrians per 100 m of sidewalk.
      cyclist_density: mean cyclists per 100 m of lane at the curb.
    """
    static = [_parked_along_lanes(net, lanes, rng), _parked_in_rows(net, rng), _road_works(net, lanes, rng)]
    crosswalks = _find_crosswalks(net)
    pedestrians = _draw_pedestrians(net, lanes, pedestrian_density, rng)
    crossing = [
        CrosswalkWalker(crosswalk, rng.uniform(-6, 4), rng.normal(1.35, 0.2), rng.normal(0, 0.5))
        for crosswalk in crosswalks
        for _ in range(rng.poisson(min(0.8 * pedestrian_density, 2.0)))
    ]
    cyclists = _draw_cyclists(net, lanes, cyclist_density, rng)
    return Bystanders(actors.concatenate_actors(static), pedestrians, crossing, cyclists)


def bystanders_at(
    bystanders: Bystanders, lanes: LaneArrays, signals: np.ndarray, time: float, rng: np.random.Generator
) -> Actors:
    """All bystanders at ``time`` [s].

    Pedestrians wait at a crosswalk while a connector that it crosses has a green signal in ``signals`` [lanes].
    """
    groups = [
        bystanders.static,
        _along_lanes(AgentType.PEDESTRIAN, bystanders.pedestrians, lanes, time, rng),
        _along_lanes(AgentType.CYCLIST, bystanders.cyclists, lanes, time, rng),
        _on_crosswalks(bystanders.crossing_pedestrians, signals, time, rng),
    ]
    return actors.concatenate_actors(groups)


def _along_lanes(
    agent_type: AgentType, walkers: list[LaneWalker], lanes: LaneArrays, time: float, rng: np.random.Generator
) -> Actors:
    if not walkers:
        return actors.no_actors()
    lane = np.array([walker.lane for walker in walkers])
    speed = np.array([walker.speed for walker in walkers])
    start = np.array([walker.start for walker in walkers])
    positions, headings = lanes.poses_at(lane, np.mod(start + speed * time, lanes.length[lane]))
    positions = _shift_right(positions, headings, np.array([walker.right for walker in walkers]))
    headings = headings + np.pi * (speed < 0)
    sizes = actors.draw_sizes(agent_type, len(walkers), rng)
    return actors.make_actors(agent_type, positions, headings, np.abs(speed), sizes)


def _on_crosswalks(
    walkers: list[CrosswalkWalker], signals: np.ndarray, time: float, rng: np.random.Generator
) -> Actors:
    if not walkers:
        return actors.no_actors()
    states = []
    for walker in walkers:
        start, end, connectors = walker.crosswalk
        length, speed = float(np.hypot(*(end - start))), walker.speed
        cycle = length + 2 * _CROSSWALK_APPROACH
        along = (walker.start + speed * time + _CROSSWALK_APPROACH) % cycle - _CROSSWALK_APPROACH
        if 0.0 < along < length and (signals[connectors] == Signal.GO).any():
            along, speed = -1.0 - abs(walker.right), 0.15 * speed  # waits at the curb
        direction = (end - start) / length
        position = start + along * direction + walker.right * np.array([-direction[1], direction[0]])
        states.append((*position, np.arctan2(direction[1], direction[0]), speed))
    table = np.array(states)
    sizes = actors.draw_sizes(AgentType.PEDESTRIAN, len(table), rng)
    return actors.make_actors(AgentType.PEDESTRIAN, table[:, :2], table[:, 2], table[:, 3], sizes)


def _draw_pedestrians(net: Network, lanes: LaneArrays, density: float, rng: np.random.Generator) -> list[LaneWalker]:
    """Groups of one to four pedestrians on sidewalks."""
    walkers = []
    for lane in net.sidewalk_lanes:
        for _ in range(rng.poisson(density * lanes.length[lane] / 100)):
            group = 1 + int(rng.geometric(0.65) - 1)
            start, right = rng.uniform(0, lanes.length[lane]), 0.5 * net.lanes[lane].width + rng.uniform(1.2, 4.5)
            speed = float(rng.choice([-1, 1]) * _draw_walking_speed(rng))
            walkers += [
                LaneWalker(lane, start + rng.normal(0, 0.8), speed, right + 0.9 * k) for k in range(min(group, 4))
            ]
    return walkers


def _draw_cyclists(net: Network, lanes: LaneArrays, density: float, rng: np.random.Generator) -> list[LaneWalker]:
    """Cyclists at the right edge of lanes."""
    riders = []
    for k, lane in enumerate(net.lanes):
        if not lane.at_curb or lane.subtype == "freeway" or lane.height != 0.0:
            continue
        for _ in range(rng.poisson(density * lanes.length[k] / 100)):
            right = 0.5 * lane.width - rng.uniform(0.2, 0.6)
            riders.append(LaneWalker(k, rng.uniform(0, lanes.length[k]), rng.gamma(6.0, 0.7), right))
    return riders


def _draw_walking_speed(rng: np.random.Generator) -> float:
    """Speed of a pedestrian on a sidewalk [m/s]: a quarter stand, a fifth stroll, the others walk."""
    share = rng.random()
    return rng.uniform(0, 0.2) if share < 0.25 else rng.uniform(0.2, 0.9) if share < 0.45 else rng.normal(1.25, 0.28)


def _parked_along_lanes(net: Network, lanes: LaneArrays, rng: np.random.Generator) -> Actors:
    lane_of, along, right = [], [], []
    for lane in net.parking_lanes:
        if lanes.length[lane] < 25 or rng.random() < 0.15:
            continue
        occupancy, position = rng.uniform(0.2, 0.95), 10.0 + rng.uniform(0, 5)
        while position < lanes.length[lane] - 12.0:
            if rng.random() < occupancy:
                lane_of.append(lane)
                along.append(position)
                right.append(0.5 * net.lanes[lane].width + rng.uniform(0.55, 1.2))
            position += rng.uniform(6.2, 7.2)
    if not lane_of:
        return actors.no_actors()
    positions, headings = lanes.poses_at(np.array(lane_of), np.array(along))
    positions = _shift_right(positions, headings, np.array(right))
    headings = headings + rng.normal(0, 0.02, len(headings))
    sizes = actors.draw_vehicle_sizes(len(positions), rng, long=False)
    return actors.make_actors(AgentType.VEHICLE, positions, headings, 0.0, sizes)


def _parked_in_rows(net: Network, rng: np.random.Generator) -> Actors:
    groups = []
    for row in net.parking_rows:
        bays = int(row.length / _BAY_WIDTH)
        occupied = np.flatnonzero(rng.random(bays) < rng.uniform(0.25, 0.9))
        if not len(occupied):
            continue
        along = (occupied - (bays - 1) / 2) * _BAY_WIDTH
        direction = np.array([np.cos(row.direction), np.sin(row.direction)])
        is_reversed = rng.random(len(occupied)) < 0.25
        headings = row.vehicle_heading + np.pi * is_reversed + rng.normal(0, 0.02, len(occupied))
        positions = row.center + along[:, None] * direction + rng.normal(0, 0.06, (len(occupied), 2))
        sizes = actors.draw_vehicle_sizes(len(occupied), rng, long=False)
        groups.append(actors.make_actors(AgentType.VEHICLE, positions, headings, 0.0, sizes))
    return actors.concatenate_actors(groups) if groups else actors.no_actors()


def _road_works(net: Network, lanes: LaneArrays, rng: np.random.Generator) -> Actors:
    """With probability 0.15 a row of cones or barriers along the edge of a road."""
    edges = [
        k for k, lane in enumerate(net.lanes) if lane.at_curb and lanes.length[k] > 30 and k not in net.parking_lanes
    ]
    if not edges or rng.random() > 0.15:
        return actors.no_actors()
    lane = int(rng.choice(edges))
    count = int(rng.integers(4, 10))
    along = rng.uniform(5, lanes.length[lane] - 20) + rng.uniform(2.5, 4.0) * np.arange(count)
    along = along[along < lanes.length[lane] - 3]
    positions, headings = lanes.poses_at(np.full(len(along), lane), along)
    right = 0.5 * net.lanes[lane].width + rng.uniform(0.2, 0.7)
    positions = _shift_right(positions, headings, np.full(len(along), right))
    size = actors.CONE_SIZE if rng.random() < 0.6 else actors.BARRIER_SIZE
    return actors.make_actors(AgentType.STATIC, positions, headings, 0.0, size)


def _find_crosswalks(net: Network) -> list[Crosswalk]:
    """Crosswalks in both directions, in front of the stop line of every arm with a sidewalk."""
    crosswalks = []
    sidewalk_lanes = set(net.sidewalk_lanes)
    for junction in net.junctions:
        if junction.type in ("merge", "driveway"):
            continue
        for a, arm in enumerate(junction.arms):
            arm_lanes = [lane for lane, _ in arm.inbound] + arm.outbound
            if not sidewalk_lanes & set(arm_lanes):
                continue
            outwards = np.array([np.cos(arm.angle), np.sin(arm.angle)])
            left = np.array([-outwards[1], outwards[0]])
            ends = [net.lanes[lane].points[-1] for lane, _ in arm.inbound]
            ends += [net.lanes[lane].points[0] for lane in arm.outbound]
            lateral = (np.array(ends) - junction.center) @ left
            middle = junction.center + (((np.array(ends) - junction.center) @ outwards).min() - 1.8) * outwards
            start, end = middle + (lateral.min() - 2.6) * left, middle + (lateral.max() + 2.6) * left
            connectors = [k for k in junction.connectors if net.lanes[k].arm == a and net.lanes[k].turn == "through"]
            crosswalks += [Crosswalk(start, end, connectors), Crosswalk(end, start, connectors)]
    return crosswalks


def _shift_right(positions: np.ndarray, headings: np.ndarray, right: np.ndarray) -> np.ndarray:
    return positions + right[:, None] * np.stack([np.sin(headings), -np.cos(headings)], -1)
