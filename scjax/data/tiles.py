"""Ego poses at which a log is cut, and the evaluation tiles there (the rule of the shared evaluation set)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.data import ragged
from scjax.data.lane_graph import LaneGraph, SegmentIndex, nearest_lane
from scjax.scene import MAX_AGENTS, MAX_LANES, POINTS_PER_LANE, TILE_SIZE, AgentType, Log

OFF_ROAD_DISTANCE = 2.5  # m from every centerline beyond which a vehicle is parked off the road
EGO_LANE_DISTANCE = 1.5  # m; an ego drives on a lane
EGO_HEADING_DIFFERENCE = np.deg2rad(45.0)
EGO_RADIUS = 30.0  # m from the recording car; farther out too many agents go unseen
CENTERED_WINDOW = (-TILE_SIZE / 2, TILE_SIZE / 2, -TILE_SIZE / 2, TILE_SIZE / 2)


@dataclasses.dataclass(frozen=True)
class Pose:
    """The pose of an ego in a log.

    Attributes:
      step, object_index: of the ego in the log.
      x, y, yaw: in the log's frame [m, rad].
      ground: z of the ground there [m].
      is_recorder: whether the ego is the recording car.
    """

    step: int
    object_index: int
    x: float
    y: float
    yaw: float
    ground: float
    is_recorder: bool


@dataclasses.dataclass(frozen=True)
class PoseAgents:
    """Agents at the step of a pose, in its frame: the ego first, then by distance.

    Attributes:
      states: nine columns of ``Scene.agents`` as recorded: NaN where unknown, outliers in.
      types: ``AgentType``.
      source: index of the object in the log.
      lane_distance: to the nearest centerline of the log [m].
      off_road: vehicles, except the ego, farther than ``OFF_ROAD_DISTANCE`` from every centerline.
    """

    states: Float64[np.ndarray, "agents 9"]
    types: Int[np.ndarray, " agents"]
    source: Int[np.ndarray, " agents"]
    lane_distance: Float64[np.ndarray, " agents"]
    off_road: Bool[np.ndarray, " agents"]


@dataclasses.dataclass(frozen=True)
class EvalTile:
    """What the evaluation set holds of one pose.

    Attributes:
      lanes, successors: centerlines [m], and pairs (i, j) where lane j follows lane i.
      main, all: which agents belong to the set's two variants: without and with vehicles parked off the road.
    """

    lanes: Float64[np.ndarray, "lanes 20 3"]
    successors: Int[np.ndarray, "edges 2"]
    agents: PoseAgents
    main: Bool[np.ndarray, " agents"]
    all: Bool[np.ndarray, " agents"]


def find_poses(
    log: Log,
    index: SegmentIndex,
    *,
    spacing: float = 16.0,
    max_poses: int = 8,
    recorder_stride: int = 10,
    other_stride: int = 30,
    first: Sequence[Pose] = (),
) -> list[Pose]:
    """Poses of a log, at least ``spacing`` [m] apart over all steps, at most ``max_poses`` (evaluation rule, step 4).

    First come those of the recording car, every ``recorder_stride`` steps. Then, every ``other_stride`` steps, come
    other vehicles within 30 m of it that drive on a lane. In a log without such a car, any vehicle that drives on a
    lane is taken.

    Args:
      first: poses to begin with, for a denser set around an earlier one; they count as the first of ``max_poses``.

    Raises:
      ValueError: on a spacing, count or stride that is not positive.
    """
    options = {
        "spacing": spacing,
        "max_poses": max_poses,
        "recorder_stride": recorder_stride,
        "other_stride": other_stride,
    }
    for name, value in options.items():
        if value <= 0:
            raise ValueError(f"{name} is {value}: it must be positive")
    accepted = [(pose.step, pose.object_index) for pose in first]
    places = np.full((max(max_poses, len(first)), 2), np.inf)
    places[: len(first)] = [(pose.x, pose.y) for pose in first] or np.zeros((0, 2))

    def accept(step: int, row: int) -> None:
        place = log.positions[row, step, :2]
        if len(accepted) < max_poses and (np.hypot(*(places - place).T) >= spacing).all():
            places[len(accepted)] = place
            accepted.append((step, row))

    ego = log.ego_index
    if ego >= 0:
        for step in np.flatnonzero(log.valid[ego, ::recorder_stride]) * recorder_stride:
            accept(int(step), ego)
    for step in range(0, log.num_steps, other_stride):
        if len(accepted) < max_poses and (ego < 0 or log.valid[ego, step]):
            for row in _driving_vehicles(log, index, step):
                accept(step, row)
    return [*first, *(pose_of(log, index, step, row) for step, row in accepted[len(first) :])]


def _driving_vehicles(log: Log, index: SegmentIndex, step: int) -> list[int]:
    """Vehicles on a lane in its direction, other than the recording car and within ``EGO_RADIUS`` of it."""
    rows = np.flatnonzero(log.valid[:, step] & (log.object_types == AgentType.VEHICLE))
    if log.ego_index >= 0:
        rows = rows[rows != log.ego_index]
        offset = log.positions[rows, step, :2] - log.positions[log.ego_index, step, :2]
        rows = rows[np.hypot(*offset.T) <= EGO_RADIUS]
    distance, heading, _ = nearest_lane(index, log.positions[rows, step, :2])
    turn = np.abs(np.angle(np.exp(1j * (log.headings[rows, step] - heading))))
    return rows[(distance <= EGO_LANE_DISTANCE) & (turn <= EGO_HEADING_DIFFERENCE)].tolist()


def pose_of(log: Log, index: SegmentIndex, step: int, object_index: int) -> Pose:
    """The pose of an object at a step."""
    x, y, z = log.positions[object_index, step]
    height = log.sizes[object_index, 2]
    ground = z if np.isnan(height) else z - height / 2
    if np.isnan(z):
        # Agents without elevation (AV2 forecasting): take that of the lane under the ego, NaN too on flat maps.
        ground = nearest_lane(index, np.array([[x, y]]))[2][0]
    yaw = log.headings[object_index, step]
    return Pose(step, object_index, float(x), float(y), float(yaw), float(ground), object_index == log.ego_index)


def to_pose_frame(points: Float64[np.ndarray, "points 3"], pose: Pose) -> Float64[np.ndarray, "points 3"]:
    """Coordinates of the log as x forward, y left, z above the ground under the ego of ``pose``."""
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    x, y = points[:, 0] - pose.x, points[:, 1] - pose.y
    return np.stack([cos * x + sin * y, cos * y - sin * x, points[:, 2] - pose.ground], -1)


def agents_at(log: Log, index: SegmentIndex, pose: Pose, radius: float, *, square: bool = False) -> PoseAgents:
    """Agents of a known type at the step of ``pose``, within ``radius`` [m].

    Args:
      square: take the square of half edge ``radius`` instead of the circle.
    """
    step = pose.step
    rows = np.flatnonzero(log.valid[:, step] & (log.object_types >= 0))
    local = to_pose_frame(log.positions[rows, step], pose)
    distance = np.hypot(local[:, 0], local[:, 1])
    inside = (np.maximum(np.abs(local[:, 0]), np.abs(local[:, 1])) if square else distance) <= radius
    # The ego comes first whatever its distance, rounding included.
    order = np.argsort(np.where(rows == pose.object_index, -1.0, distance), kind="stable")
    order = order[inside[order]]
    rows, local = rows[order], local[order]
    turn = log.headings[rows, step] - pose.yaw
    speed = np.hypot(*log.velocities[rows, step].T)
    states = np.concatenate(
        [local, speed[:, None], np.cos(turn)[:, None], np.sin(turn)[:, None], log.sizes[rows]], axis=1
    )
    types = log.object_types[rows]
    lane_distance, _, _ = nearest_lane(index, log.positions[rows, step, :2])
    off_road = (types == AgentType.VEHICLE) & (lane_distance > OFF_ROAD_DISTANCE) & (rows != pose.object_index)
    return PoseAgents(states, types, rows, lane_distance, off_road)


def cut_tile(log: Log, graph: LaneGraph, index: SegmentIndex, pose: Pose) -> EvalTile:
    """The evaluation tile at ``pose``: 64 m x 64 m around the ego (evaluation rule, steps 5-7), values as recorded."""
    pieces = ragged.clip_polylines(to_pose_frame(graph.points, pose), graph.offsets, CENTERED_WINDOW)
    lanes = ragged.resample_pieces(pieces, POINTS_PER_LANE)
    order = ragged.order_by_distance(lanes)[:MAX_LANES]
    rank = np.full(len(lanes), -1)
    rank[order] = np.arange(len(order))
    successors = rank[ragged.piece_successors(pieces, graph.successors, graph.num_lanes)]
    successors = successors[(successors >= 0).all(-1)]
    agents = agents_at(log, index, pose, TILE_SIZE / 2, square=True)
    movable = np.flatnonzero(agents.types != AgentType.STATIC)
    main, everything = np.zeros(len(agents.types), bool), np.zeros(len(agents.types), bool)
    main[movable[~agents.off_road[movable]][:MAX_AGENTS]] = True
    everything[movable[:MAX_AGENTS]] = True
    return EvalTile(lanes[order], successors, agents, main, everything)
