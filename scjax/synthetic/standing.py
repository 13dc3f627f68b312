"""What stands beside traffic: parked vehicles, people at them, cones and barriers at the edge of a road."""

from __future__ import annotations

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.lane_arrays import LaneArrays
from scjax.synthetic.network import Network

_BAY_WIDTH = 2.8  # m of a parking row per vehicle
_PEOPLE_SHARE = 0.06  # of parked vehicles with somebody beside them
_CONES_SHARE = 0.35  # of worlds with a cone or barrier, or two, at the edge of a road


def draw_standing(net: Network, lanes: LaneArrays, people: bool, rng: np.random.Generator) -> Actors:
    """Random parked vehicles, cones and barriers, and with ``people`` some people beside parked vehicles."""
    parked = actors.concatenate_actors([_parked_along_lanes(net, lanes, rng), _parked_in_rows(net, rng)])
    groups = [parked, _cones_at_edge(net, lanes, rng)]
    if people:
        groups.append(_people_beside(parked, rng))
    return actors.concatenate_actors(groups)


def _people_beside(parked: Actors, rng: np.random.Generator) -> Actors:
    rows = np.flatnonzero(rng.random(len(parked)) < _PEOPLE_SHARE)
    count = len(rows)
    headings = parked.headings[rows]
    along = rng.uniform(-0.5, 0.5, count) * parked.sizes[rows, 0]
    side = rng.choice([-1.0, 1.0], count) * (parked.sizes[rows, 1] / 2 + rng.uniform(0.6, 0.9, count))
    ahead = np.stack([np.cos(headings), np.sin(headings)], -1)
    positions = parked.positions[rows] + along[:, None] * ahead
    positions = positions + side[:, None] * np.stack([-ahead[:, 1], ahead[:, 0]], -1)
    sizes = actors.draw_sizes(AgentType.PEDESTRIAN, count, rng)
    return actors.make_actors(AgentType.PEDESTRIAN, positions, rng.uniform(-np.pi, np.pi, count), 0.0, sizes)


def _parked_along_lanes(net: Network, lanes: LaneArrays, rng: np.random.Generator) -> Actors:
    lane_of, along, edge = [], [], []
    for lane in net.parking_lanes:
        if lanes.length[lane] < 25 or rng.random() < 0.15:
            continue
        occupancy, position = rng.uniform(0.1, 0.9), 10.0 + rng.uniform(0, 5)
        while position < lanes.length[lane] - 12.0:
            if rng.random() < occupancy:
                lane_of.append(lane)
                along.append(position)
                edge.append(0.5 * net.lanes[lane].width + rng.uniform(-0.4, 0.15))
            position += rng.uniform(6.2, 7.2)
    if not lane_of:
        return actors.no_actors()
    positions, headings = lanes.poses_at(np.array(lane_of), np.array(along))
    sizes = actors.draw_vehicle_sizes(len(positions), rng, long=False)
    positions = _shift_right(positions, headings, np.array(edge) + sizes[:, 1] / 2)
    headings = headings + rng.normal(0, 0.02, len(headings))
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


def _cones_at_edge(net: Network, lanes: LaneArrays, rng: np.random.Generator) -> Actors:
    """Sometimes a cone or barrier, or two, at the edge of a road."""
    edges = [
        k for k, lane in enumerate(net.lanes) if lane.at_curb and lanes.length[k] > 30 and k not in net.parking_lanes
    ]
    if not edges or rng.random() > _CONES_SHARE:
        return actors.no_actors()
    lane = int(rng.choice(edges))
    count = int(rng.integers(1, 3))
    along = rng.uniform(5, lanes.length[lane] - 20) + rng.uniform(2.5, 4.0) * np.arange(count)
    along = along[along < lanes.length[lane] - 3]
    positions, headings = lanes.poses_at(np.full(len(along), lane), along)
    right = 0.5 * net.lanes[lane].width + rng.uniform(0.2, 0.7)
    positions = _shift_right(positions, headings, np.full(len(along), right))
    size = actors.CONE_SIZE if rng.random() < 0.6 else actors.BARRIER_SIZE
    return actors.make_actors(AgentType.STATIC, positions, headings, 0.0, size)


def _shift_right(positions: np.ndarray, headings: np.ndarray, right: np.ndarray) -> np.ndarray:
    return positions + right[:, None] * np.stack([np.sin(headings), -np.cos(headings)], -1)
