"""Distribution metrics of lane graphs and vehicles, generated against real: the tables of Scenario Dreamer.

A scene contributes moments, histograms and counts (``scene_sums``); the table needs only their sums over scenes.
Definitions and scalings: metrics.md §1-2. Mode ``compat`` reproduces the reference code to rounding. Mode ``strict``
does not depend on lane order, measures distances to segments instead of points, and tests boxes instead of circles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from scjax.metrics.distances import frechet, histogram, jensen_shannon, mean_and_deviation, moments
from scjax.metrics.lanes import lane_segments, nearest_segment
from scjax.metrics.lines import resample_polylines
from scjax.metrics.pooling import Values, ratio, singles
from scjax.metrics.topology import (
    Lanes,
    Mode,
    compact_lanes,
    degrees,
    endpoint_gaps,
    key_points,
    reach_and_hops,
    route_length,
)
from scjax.scene import AgentType, Scene
from scjax.scene.boxes import overlaps

Sums = dict[str, np.ndarray]
"""Name -> sums over one or more scenes: moments [3], histogram [bins] or (numerator, denominator) [2]."""


class Quantity(NamedTuple):
    """A quantity of vehicles: range and bin width of its histogram, and the scale of its divergence in tables."""

    low: float
    high: float
    width: float
    scale: float


VEHICLE = {
    "nearest_dist": Quantity(0.0, 50.0, 1.0, 10.0),
    "lat_dev": Quantity(0.0, 1.5, 0.1, 10.0),
    "ang_dev": Quantity(-200.0, 200.0, 5.0, 100.0),
    "length": Quantity(0.0, 25.0, 0.1, 100.0),
    "width": Quantity(0.0, 5.0, 0.1, 100.0),
    "speed": Quantity(0.0, 50.0, 1.0, 100.0),
}
GRAPH = {"connectivity": 10.0, "density": 1.0, "reach": 1.0, "convenience": 10.0}
"""Quantity of the lane graph -> scale of its Fréchet distance in tables."""

ON_ROAD = 1.5  # metres from the nearest centerline
# As in the reference code:
_POINTS = 100  # per lane, in its vehicle metrics
_CIRCLES = 5  # per box, in its collision test
_CIRCLE_DIVISOR = np.sqrt(3.8)  # boxes collide where circles are closer than the sum of widths over this


def scene_sums(scene: Scene, mode: Mode = "strict") -> Sums:
    """The contribution of one scene.

    Returns:
      connectivity, density, reach, convenience: moments of degrees, number of key points, reach and hops.
      route_length, endpoint_dist: moments in metres.
      nearest_dist ... speed: histograms over vehicles with known values, including the ego.
      collision_rate: (vehicles that overlap another, vehicles).
      scenes, scenes_without_lanes, scenes_without_vehicles: counts [1]. A scene without lanes adds nothing to lane
        quantities, lat_dev and ang_dev.
    """
    return sums_by_mode(scene, (mode,))[mode]


def sums_by_mode(scene: Scene, modes: Sequence[Mode]) -> dict[Mode, Sums]:
    """``scene_sums`` for several modes; parts that do not depend on the mode are computed once."""
    (scene,) = singles(scene)
    lanes = compact_lanes(scene) if len(scene.lane_mask) else None
    graphs, vehicles = _lane_sums(lanes, modes), _vehicle_sums(scene, lanes, modes)
    return {mode: {**graphs[mode], **vehicles[mode], "scenes": np.ones(1)} for mode in modes}


def _lane_sums(lanes: Lanes | None, modes: Sequence[Mode]) -> dict[Mode, Sums]:
    if lanes is None:
        names = (*GRAPH, "route_length", "endpoint_dist")
        nothing = {**{name: np.zeros(3) for name in names}, "scenes_without_lanes": np.ones(1)}
        return dict.fromkeys(modes, nothing)
    gaps = {"endpoint_dist": moments(endpoint_gaps(lanes)), "scenes_without_lanes": np.zeros(1)}
    by_mode: dict[Mode, Sums] = {}
    graph: Sums = {}
    before = None
    for mode in modes:
        adjacency = key_points(lanes, mode)
        if before is None or not np.array_equal(before, adjacency):  # the modes rarely differ
            reach, hops = reach_and_hops(adjacency)
            values = {
                "connectivity": degrees(adjacency),
                "density": np.array([len(adjacency)]),
                "reach": reach,
                "convenience": hops,
            }
            graph, before = {name: moments(value) for name, value in values.items()}, adjacency
        route = moments(np.array([route_length(lanes, mode)]))
        by_mode[mode] = {**graph, "route_length": route, **gaps}
    return by_mode


def _vehicle_sums(scene: Scene, lanes: Lanes | None, modes: Sequence[Mode]) -> dict[Mode, Sums]:
    vehicle = scene.agent_mask & (scene.agent_types == AgentType.VEHICLE) & scene.agent_known[:, [0, 1, 4, 5]].all(-1)
    agents, known = np.asarray(scene.agents, np.float64)[vehicle], np.asarray(scene.agent_known)[vehicle]
    boxes = agents[known[:, 6:8].all(-1)]
    values = {"nearest_dist": _nearest(agents[:, :2]), "speed": agents[known[:, 3], 3]}
    values |= {"length": agents[known[:, 6], 6], "width": agents[known[:, 7], 7]}
    shared = {name: histogram(value, *VEHICLE[name][:3]) for name, value in values.items()}
    shared["scenes_without_vehicles"] = np.array([float(len(agents) == 0)])
    by_mode: dict[Mode, Sums] = {}
    for mode in modes:
        deviations = zip(("lat_dev", "ang_dev"), _lane_deviations(agents, scene, lanes, mode), strict=True)
        own = {name: histogram(value, *VEHICLE[name][:3]) for name, value in deviations}
        hit = (circles_touch(boxes) if mode == "compat" else overlaps(boxes)).any(-1)
        by_mode[mode] = {**shared, **own, "collision_rate": np.array([hit.sum(), len(boxes)], np.float64)}
    return by_mode


def add(sums: Iterable[Sums]) -> Sums:
    """Sums over scenes; empty without scenes."""
    total: Sums = {}
    for scene in sums:
        total = {name: value + total[name] for name, value in scene.items()} if total else dict(scene)
    return total


def table(generated: Sums, real: Sums) -> Values:
    """The row of the published tables with their scales; NaN where a side has no values.

    Returns:
      frechet_<quantity> (``GRAPH``); <quantity>_jsd (``VEHICLE``); of the generated side alone: route_length_mean,
      route_length_std, endpoint_dist_mean, endpoint_dist_std [m], collision_rate [% of vehicles].
    """
    row = {f"frechet_{name}": scale * frechet(generated[name], real[name]) for name, scale in GRAPH.items()}
    for name, quantity in VEHICLE.items():
        row[f"{name}_jsd"] = quantity.scale * jensen_shannon(generated[name], real[name])
    for name in ("route_length", "endpoint_dist"):
        row[f"{name}_mean"], row[f"{name}_std"] = mean_and_deviation(generated[name])
    hits, vehicles = generated["collision_rate"]
    return {**row, "collision_rate": 100 * ratio(float(hits), float(vehicles))}


def circles_touch(boxes: Float64[np.ndarray, "boxes 9"]) -> Bool[np.ndarray, "boxes boxes"]:
    """Collision test of the reference code: five circles along each box, slightly larger than tangent; diagonal
    False."""
    length, width = boxes[:, 6], boxes[:, 7]
    along = np.linspace(-length / 2 + width / 2, length / 2 - width / 2, _CIRCLES, axis=-1)
    heading = np.arctan2(boxes[:, 5], boxes[:, 4])
    ahead = np.stack([np.cos(heading), np.sin(heading)], -1)
    centers = boxes[:, None, :2] + along[..., None] * ahead[:, None]
    distance = np.linalg.norm(centers[:, None, :, None] - centers[None, :, None], axis=-1).min((2, 3), initial=np.inf)
    touch = distance < (width[:, None] + width[None]) / _CIRCLE_DIVISOR
    np.fill_diagonal(touch, False)
    return touch


def _nearest(positions: np.ndarray) -> np.ndarray:
    """Distance of each vehicle to the nearest other [m]; empty for a single vehicle."""
    if len(positions) < 2:
        return np.zeros(0)
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    return distance.min(1)


def _lane_deviations(
    agents: np.ndarray, scene: Scene, lanes: Lanes | None, mode: Mode
) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the nearest centerline [m] and signed angle to it [degrees], for vehicles on the road."""
    if not len(agents) or lanes is None:
        return np.zeros(0), np.zeros(0)
    if mode == "strict":
        distance, lane_heading = nearest_segment(agents[:, :2], lane_segments(scene))
    else:
        distance, lane_heading = _nearest_point(agents[:, :2], resample_polylines(lanes.points, _POINTS))
    on_road = distance <= ON_ROAD
    turn = (np.arctan2(agents[:, 5], agents[:, 4]) - lane_heading)[on_road]
    return distance[on_road], np.degrees(np.arctan2(np.sin(turn), np.cos(turn)))


def _nearest_point(positions: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the nearest point of any line [m], and the heading of the segment that ends there [rad]."""
    square = np.square(positions[:, None] - lines.reshape(-1, 2)[None]).sum(-1)
    best = square.argmin(1)
    line, point = best // lines.shape[1], np.maximum(best % lines.shape[1], 1)
    along = lines[line, point] - lines[line, point - 1]
    return np.sqrt(square[np.arange(len(positions)), best]), np.arctan2(along[:, 1], along[:, 0])
