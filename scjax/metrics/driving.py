"""How traffic of whole maps drives, from logs: collisions, off-road, red lights, stuck vehicles, progress.

``closed_loop`` measures single scenes of 64 m by older definitions, which published numbers use.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from scjax.metrics.closed_loop import Rollout
from scjax.metrics.distances import moments
from scjax.metrics.distributions import Sums
from scjax.metrics.kinematics import kinematics
from scjax.metrics.object_boxes import ObjectBoxes, center_distances, object_boxes, signed_box_distances
from scjax.metrics.pooling import Values, ratio
from scjax.metrics.red_lights import red_light_crossings
from scjax.metrics.road_distance import OFF_ROAD, RoadDistance
from scjax.metrics.standing import stuck_vehicles
from scjax.scene import AgentType, Log
from scjax.scene.boxes import TOUCH

_MAX_ACCELERATION, _MAX_CURVATURE = 10.4, 0.3  # m/s^2, 1/m; beyond, no car follows (thresholds of Waymax)
_STEERING_SPEED = 0.6  # m/s; curvature is noise below
_MOVING = 0.1  # m/s; slower steps are noise of the recording, and no progress
_BLOCK = 4_000_000  # entries of the table of distances that are held at once


def driving_sums(log: Log) -> Sums:
    """Contribution of one log: (numerator, denominator) [2] and moments [3].

    Returns:
      scenes_collision: logs with a collision / logs. ego_collision: logs in which the ego collides / logs with an ego.
      collision: objects that collide with another / objects. vehicle_collision: the same among vehicles. A collision
        is a pair of boxes that overlap at a step. Pairs that overlap at step 0 are left out at all steps.
      off_road: vehicles whose center is more than 2.5 m from every centerline at a step / vehicles that begin nearer.
      red_light: vehicles whose front crosses a stop point while its signal is STOP / vehicles
        (``red_light_crossings``). Turns on red that a law allows count too.
      stuck: vehicles that stand for more than 10 s without a reason / vehicles that are there for as long
        (``stuck_vehicles``).
      infeasible: steps of vehicles with more than 10.4 m/s^2 or a curvature above 0.3 1/m / such steps that are known.
      progress: moments of the path that each vehicle drives [m]; progress_speed: of that path / its time [m/s].

    Raises:
      ValueError: the log has one step only, or NaN at valid steps.
    """
    boxes, road = object_boxes(log), RoadDistance(log.lanes)
    present = np.asarray(boxes.valid.any(-1))
    vehicle = np.asarray(present & (boxes.types == AgentType.VEHICLE))
    hit, hit_vehicle = _collisions(boxes)
    centers = road_distances(boxes, vehicle, road)
    first = boxes.valid.argmax(-1)
    began = vehicle & (centers[np.arange(len(first)), first] <= OFF_ROAD)
    off = np.asarray((boxes.valid & (centers > OFF_ROAD)).any(-1))
    stuck, long_enough = stuck_vehicles(log, boxes, centers)
    crossings = red_light_crossings(log, boxes, boxes.half[:, 0])
    path, seconds = _paths(log, boxes)
    has_ego = log.ego_index >= 0 and bool(present[log.ego_index])
    return {
        "scenes_collision": np.array([float(hit.any()), 1.0]),
        "ego_collision": np.array([float(has_ego and hit[log.ego_index]), float(has_ego)]),
        "collision": _share(hit, present),
        "vehicle_collision": _share(hit_vehicle, vehicle),
        "off_road": _share(off, began),
        "red_light": _share(np.asarray(crossings.any(-1)), vehicle),
        "stuck": _share(stuck, vehicle & long_enough),
        "infeasible": _infeasible(boxes, vehicle),
        "progress": moments(path[vehicle]),
        "progress_speed": moments((path / np.maximum(seconds, 1e-9))[vehicle & (seconds > 0)]),
    }


def driving_table(sums: Sums) -> Values:
    """Percentages, and means [m] and [m/s], from the added sums of ``driving_sums``; NaN where nothing was counted."""
    row = {}
    for name, value in sums.items():
        if value.shape == (2,):
            row[name] = 100 * ratio(float(value[0]), float(value[1]))
        else:
            row[name] = ratio(float(value[1]), float(value[0]))
    return row


def rollout_of_log(log: Log) -> Rollout:
    """The objects of a log for ``closed_loop.motion_sums``: the ego first, sizes that are not known by class.

    Signals stay behind, since those of a ``Rollout`` belong to the lanes of a scene.

    Raises:
      ValueError: the log has one step only, or NaN at valid steps.
    """
    boxes = object_boxes(log)
    order = np.argsort(np.arange(log.num_objects) != log.ego_index, kind="stable")
    speeds = np.hypot(*np.moveaxis(log.velocities, -1, 0))
    states = np.concatenate([boxes.positions, boxes.headings[..., None], speeds[..., None]], -1)
    return Rollout(
        states[order].transpose(1, 0, 2), boxes.valid[order].T, 2 * boxes.half[order], boxes.types[order], boxes.dt
    )


def road_distances(boxes: ObjectBoxes, rows: Bool[np.ndarray, " N"], road: RoadDistance) -> Float64[np.ndarray, "N T"]:
    """Distance of the centers of some objects to the nearest centerline [m]; inf without lanes, 0 for other objects."""
    distance = np.zeros(boxes.valid.shape)
    where = boxes.valid & rows[:, None]
    distance[where] = road(boxes.positions[where])
    return distance


def _share(flags: np.ndarray, among: np.ndarray) -> np.ndarray:
    return np.array([float((flags & among).sum()), float(among.sum())])


def _collisions(boxes: ObjectBoxes) -> tuple[np.ndarray, np.ndarray]:
    """Objects that collide with another [N], and vehicles that collide with a vehicle [N]."""
    count, steps = boxes.valid.shape
    hit, among = np.zeros(count, bool), np.zeros(count, bool)
    vehicle = boxes.types == AgentType.VEHICLE
    outer = np.linalg.norm(boxes.half, axis=-1)
    block = max(1, _BLOCK // max(count * steps, 1))
    for start in range(0, count, block):
        rows = np.arange(start, min(start + block, count))
        apart = center_distances(boxes, rows)
        row, other, step = np.nonzero(apart < (outer[rows, None] + outer)[..., None])
        own = rows[row]
        distance = signed_box_distances(
            (boxes.positions[own, step], boxes.positions[other, step]),
            (boxes.headings[own, step], boxes.headings[other, step]),
            (boxes.half[own], boxes.half[other]),
            rounding=0.0,
        )
        own, other, step = (values[distance < -TOUCH] for values in (own, other, step))
        pair = own * count + other
        counts = ~np.isin(pair, pair[step == 0])
        own, other = own[counts], other[counts]
        hit[own] = True
        both = vehicle[own] & vehicle[other]
        among[own[both]] = True
    return hit, among


def _infeasible(boxes: ObjectBoxes, vehicle: np.ndarray) -> np.ndarray:
    motion = kinematics(boxes.positions[vehicle], boxes.headings[vehicle], boxes.valid[vehicle], boxes.dt)
    known = np.isfinite(motion.acceleration)
    moving = motion.speed > _STEERING_SPEED
    curvature = np.divide(motion.angular_speed, motion.speed, out=np.zeros(motion.speed.shape), where=moving)
    beyond = (np.abs(motion.acceleration) > _MAX_ACCELERATION) | (np.abs(curvature) > _MAX_CURVATURE)
    return _share(beyond, known)


def _paths(log: Log, boxes: ObjectBoxes) -> tuple[np.ndarray, np.ndarray]:
    """Path of each object [m], and the time between its valid steps [s]."""
    both = boxes.valid[:, 1:] & boxes.valid[:, :-1]
    pause = np.diff(log.timestamps)
    step = np.linalg.norm(np.diff(boxes.positions, axis=1), axis=-1)
    moves = both & (step > _MOVING * pause)
    return np.where(moves, step, 0.0).sum(-1), np.where(both, pause, 0.0).sum(-1)
