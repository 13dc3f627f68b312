"""Realism of single scenes: open lane connections, vehicles off their lane or heading, overlapping boxes."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float64, Int

from scjax.metrics.lanes import lane_segments, nearest_segment
from scjax.metrics.pooling import Ratios, Values, pool, singles, values
from scjax.scene import AgentType, Link, Scene
from scjax.scene.boxes import intersection_areas, overlaps

ON_LANE = 1.5  # metres from the nearest centerline (metrics.md §2)
OPEN_CONNECTION = 1.0  # metres; a larger gap is open
OVERLAPS = (0.01, 0.1)  # thresholds of intersection over union
OFF_HEADING = 45.0  # degrees from the nearest segment


def scene_realism(scene: Scene, *, ego: bool = True) -> Ratios:
    """Ratios of one scene.

    Args:
      scene: a single scene.
      ego: whether the ego counts among the vehicles and boxes.

    Returns:
      connection_gap_m: end of lane i to start of lane j of predecessor links, in xy [m]; open_connections: share > 1 m.
      vehicles_on_lane: share of vehicles within 1.5 m of a centerline.
      lane_angle_deg: |heading - heading of the nearest segment| of vehicles on a lane [degrees]; off_heading: share >
        45.
      vehicles_overlapping: share of vehicles that overlap another vehicle (veh_obb in baselines.md).
      vehicle_overlap_pairs: overlapping pairs of vehicles per scene.
      scenes_vehicle_overlap, scenes_any_overlap: share of scenes with an overlapping pair of vehicles, of any agents.
      scenes_overlap_iou_0.01, scenes_overlap_iou_0.1: the same with more than that intersection over union.
      Boxes of unknown size are left out of overlaps.
    """
    (scene,) = singles(scene)
    gaps = connection_gaps(scene)
    distance, angle = lane_offsets(scene, ego=ego)
    on_lane = distance <= ON_LANE
    pairs = overlapping_pairs(scene, ego=ego)
    shared = _intersections_over_unions(np.asarray(scene.agents, np.float64), pairs)
    vehicle = scene.agent_types == AgentType.VEHICLE
    among = pairs[vehicle[pairs].all(-1)]
    boxes = vehicle & _known_boxes(scene, ego)
    return {
        "connection_gap_m": (float(gaps.sum()), float(gaps.size)),
        "open_connections": (float((gaps > OPEN_CONNECTION).sum()), float(gaps.size)),
        "vehicles_on_lane": (float(on_lane.sum()), float(on_lane.size)),
        "lane_angle_deg": (float(angle[on_lane].sum()), float(on_lane.sum())),
        "off_heading": (float((angle[on_lane] > OFF_HEADING).sum()), float(on_lane.sum())),
        "vehicles_overlapping": (float(np.unique(among).size), float(boxes.sum())),
        "vehicle_overlap_pairs": (float(len(among)), 1.0),
        "scenes_vehicle_overlap": (float(len(among) > 0), 1.0),
        "scenes_any_overlap": (float(len(pairs) > 0), 1.0),
        **{f"scenes_overlap_iou_{least:g}": (float((shared > least).any()), 1.0) for least in OVERLAPS},
    }


def realism(scenes: Scene | Iterable[Scene], *, ego: bool = True) -> Values:
    """``scene_realism`` pooled over a stream of scenes."""
    return values(pool(scene_realism(scene, ego=ego) for scene in singles(scenes)))


def connection_gaps(scene: Scene) -> Float64[np.ndarray, " connections"]:
    """xy distance from the end of lane i to the start of lane j, for every predecessor link of one scene [m]."""
    mask = np.asarray(scene.lane_mask)
    pairs = np.argwhere((np.asarray(scene.links) == Link.PREDECESSOR) & mask[:, None] & mask[None, :])
    lanes = np.asarray(scene.lanes, np.float64)
    return np.linalg.norm(lanes[pairs[:, 0], -1, :2] - lanes[pairs[:, 1], 0, :2], axis=-1)


def lane_offsets(
    scene: Scene, *, ego: bool = True
) -> tuple[Float64[np.ndarray, " vehicles"], Float64[np.ndarray, " vehicles"]]:
    """For every vehicle of one scene: distance to the nearest centerline [m] and |angle| to its segment [degrees].

    The distance is infinite without lanes.
    """
    vehicle = scene.agent_mask & (scene.agent_types == AgentType.VEHICLE) & scene.agent_known[:, [0, 1, 4, 5]].all(-1)
    if not ego:
        vehicle[:1] = False
    agents = np.asarray(scene.agents, np.float64)[vehicle]
    distance, heading = nearest_segment(agents[:, :2], lane_segments(scene))
    turn = np.arctan2(agents[:, 5], agents[:, 4]) - heading
    return distance, np.abs(np.rad2deg(np.arctan2(np.sin(turn), np.cos(turn))))


def overlapping_pairs(scene: Scene, *, ego: bool = True) -> Int[np.ndarray, "pairs 2"]:
    """Pairs (i, j), i < j, of agents of one scene whose boxes overlap; both with known position and size."""
    rows = np.flatnonzero(_known_boxes(scene, ego))
    row_pairs = np.argwhere(np.triu(overlaps(np.asarray(scene.agents)[rows])))
    return rows[row_pairs]


def _intersections_over_unions(agents: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    if not len(pairs):
        return np.zeros(0)
    area, size = intersection_areas(agents[pairs[:, 0]], agents[pairs[:, 1]]), agents[:, 6] * agents[:, 7]
    return area / np.maximum(size[pairs].sum(1) - area, 1e-9)


def _known_boxes(scene: Scene, ego: bool) -> np.ndarray:
    known = np.asarray(scene.agent_mask & scene.agent_known[:, [0, 1, 4, 5, 6, 7]].all(-1))
    if not ego:
        known[:1] = False
    return known
