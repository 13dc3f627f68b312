"""What the Waymo Open Sim Agents Challenge measures of the motion of objects, from a ``Log``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.metrics.kinematics import kinematics
from scjax.metrics.object_boxes import ObjectBoxes, center_distances, corner_points, nearest_object_distances
from scjax.metrics.red_lights import red_light_crossings
from scjax.metrics.road_distance import OFF_ROAD, RoadDistance
from scjax.metrics.time_to_collision import times_to_collision
from scjax.scene import AgentType, Log

HALF_LANE = 1.75
"""From the centerline to the edge of the corridor of a lane [m]."""


class Feature(NamedTuple):
    """A feature of some objects over time; values mean nothing where ``valid`` is False."""

    values: Float64[np.ndarray, "rows T"]
    valid: Bool[np.ndarray, "rows T"]


def motion_features(
    log: Log, boxes: ObjectBoxes, rows: Int[np.ndarray, " rows"], road: RoadDistance
) -> dict[str, Feature]:
    """All features of ``scjax.metrics.motion_likelihood.FEATURES`` for some objects of a log.

    Those that happen or not are 1 and 0 at the steps. Distances and times count all objects of the log as obstacles.

    Where it differs from the challenge:

    - Speeds are in the plane, since many sources have no height.
    - Maps have no road edges. The distance to the road edge is that of the corner of the box that is farthest from any
      centerline, minus 1.75 m: positive off the corridors of all lanes. It is at least -1.75 m, so most values on a
      road fall into one of the published bins, which are 6 m wide.
    - An object is off the road if its center is more than 2.5 m from every centerline. By the corridors, 42 % of the
      moving vehicles of 134 recordings would be off the road, since many lanes are wider; by this rule 11 % are.
    - The signal that an object passes is found by its stop line (``red_light_crossings``), not by the nearest lane.
    """
    valid = boxes.valid[rows]
    motion = kinematics(boxes.positions, boxes.headings, boxes.valid, boxes.dt)
    apart = center_distances(boxes, rows)
    nearest = nearest_object_distances(boxes, rows, apart)
    features = {
        "linear_speed": _known(motion.speed[rows]),
        "linear_acceleration": _known(motion.acceleration[rows]),
        "angular_speed": _known(motion.angular_speed[rows]),
        "angular_acceleration": _known(motion.angular_acceleration[rows]),
        "distance_to_nearest_object": Feature(nearest, valid),
        "collision_indication": Feature((nearest < 0).astype(float), valid),
    }
    vehicle = valid & (boxes.types[rows] == AgentType.VEHICLE)[:, None]
    features["time_to_collision"] = Feature(times_to_collision(boxes, rows, apart, motion.speed), vehicle)
    on_map = valid & road.has_lanes
    edge, off_road = np.zeros(valid.shape), np.zeros(valid.shape)
    row, step = np.nonzero(on_map)
    own = rows[row]
    centers = boxes.positions[own, step]
    corners = corner_points(centers, boxes.headings[own, step], boxes.half[own])
    edge[row, step] = road(corners.reshape(-1, 2)).reshape(-1, 4).max(-1) - HALF_LANE
    off_road[row, step] = road(centers) > OFF_ROAD
    features["distance_to_road_edge"] = Feature(edge, on_map)
    features["offroad_indication"] = Feature(off_road, on_map)
    crossed = red_light_crossings(log, boxes)[rows].astype(float)
    features["traffic_light_violation"] = Feature(crossed, vehicle)
    return features


def _known(values: np.ndarray) -> Feature:
    return Feature(values, np.isfinite(values))
