"""Ego poses worth cutting a scene at, and the evaluation tiles cut there (the cutting rule of the shared eval set)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.data import ragged
from scjax.data.lane_graph import LaneGraph, SegmentIndex, nearest_lane
from scjax.data.readers.scene_json import RawScene
from scjax.scene import MAX_AGENTS, MAX_LANES, POINTS_PER_LANE, TILE_SIZE, AgentType

OFF_ROAD = 2.5  # metres from every centreline beyond which a vehicle is parked off the road
EGO_LANE_DISTANCE = 1.5  # metres; an ego drives on a lane
EGO_HEADING = np.deg2rad(45.0)
EGO_RADIUS = 30.0  # metres from the recording car: further out too many agents go unseen
CENTRED_WINDOW = (-TILE_SIZE / 2, TILE_SIZE / 2, -TILE_SIZE / 2, TILE_SIZE / 2)


@dataclasses.dataclass(frozen=True)
class Pose:
    """An ego at a step: index of the object, its x, y [m] and yaw [rad] in the source frame, z of the ground there."""

    step: int
    object: int
    x: float
    y: float
    yaw: float
    ground: float
    is_recorder: bool


@dataclasses.dataclass(frozen=True)
class Agents:
    """Agents of one step in the frame of a pose, nearest first behind the ego: the nine columns of ``Scene.agents``.

    Values as recorded: NaN where unknown, outliers in.
    """

    states: Float64[np.ndarray, "agents 9"]
    types: Int[np.ndarray, " agents"]
    source: Int[np.ndarray, " agents"]  # index of the object
    lane_distance: Float64[np.ndarray, " agents"]  # metres to the nearest centreline of the scene
    off_road: Bool[np.ndarray, " agents"]  # a vehicle, other than the ego, beyond OFF_ROAD


@dataclasses.dataclass(frozen=True)
class Tile:
    """What the evaluation set holds of one pose; ``main`` and ``all`` are its two variants of the agents."""

    lanes: Float64[np.ndarray, "lanes 20 3"]
    edges: Int[np.ndarray, "edges 2"]
    agents: Agents
    main: Bool[np.ndarray, " agents"]
    all: Bool[np.ndarray, " agents"]


def find_poses(
    raw: RawScene,
    index: SegmentIndex,
    *,
    spacing: float = 16.0,
    max_poses: int = 8,
    recorder_stride: int = 10,
    other_stride: int = 30,
    first: Sequence[Pose] = (),
) -> list[Pose]:
    """Poses of a scene, at least ``spacing`` metres apart over all steps, at most ``max_poses`` (eval rule, step 4).

    First the recording car every ``recorder_stride`` steps, then, every ``other_stride`` steps, other vehicles within
    30 m of it that drive on a lane. In a recording without such a car every vehicle that drives on a lane will do.

    Args:
      first: poses to begin with, for a denser set around a given one; they count as the first of ``max_poses``.

    Raises:
      ValueError: on a spacing, count or stride that is not positive.
    """
    for name, value in (("spacing", spacing), ("max_poses", max_poses), ("recorder_stride", recorder_stride),
                        ("other_stride", other_stride)):  # fmt: skip
        if value <= 0:
            raise ValueError(f"{name} is {value}: it must be positive")
    accepted = [(pose.step, pose.object) for pose in first]
    places = np.full((max(max_poses, len(first)), 2), np.inf)
    places[: len(first)] = [(pose.x, pose.y) for pose in first] or np.zeros((0, 2))

    def accept(step: int, who: int) -> None:
        place = raw.positions[who, step, :2]
        if len(accepted) < max_poses and (np.hypot(*(places - place).T) >= spacing).all():
            places[len(accepted)] = place
            accepted.append((step, who))

    recorder = raw.recorder
    if recorder >= 0:
        for step in np.flatnonzero(raw.valid[recorder, ::recorder_stride]) * recorder_stride:
            accept(int(step), recorder)
    for step in range(0, raw.num_steps, other_stride):
        if len(accepted) >= max_poses or (recorder >= 0 and not raw.valid[recorder, step]):
            continue
        who = np.flatnonzero(raw.valid[:, step] & (raw.types == AgentType.VEHICLE))
        who = who[who != recorder]
        if recorder >= 0:
            gap = raw.positions[who, step, :2] - raw.positions[recorder, step, :2]
            who = who[np.hypot(*gap.T) <= EGO_RADIUS]
        distance, heading, _ = nearest_lane(index, raw.positions[who, step, :2])
        turn = np.abs(np.angle(np.exp(1j * (raw.headings[who, step] - heading))))
        for vehicle in who[(distance <= EGO_LANE_DISTANCE) & (turn <= EGO_HEADING)]:
            accept(step, int(vehicle))
    return [*first, *(pose_of(raw, index, step, who) for step, who in accepted[len(first) :])]


def pose_of(raw: RawScene, index: SegmentIndex, step: int, who: int) -> Pose:
    """The pose of an object at a step."""
    x, y, z = raw.positions[who, step]
    height = raw.sizes[who, 2]
    ground = z if np.isnan(height) else z - height / 2
    if np.isnan(z):
        # No elevation of agents (AV2 forecasting): the lane under the ego stands in, unknown too on flat maps.
        ground = nearest_lane(index, np.array([[x, y]]))[2][0]
    return Pose(step, who, float(x), float(y), float(raw.headings[who, step]), float(ground), who == raw.recorder)


def to_pose_frame(points: Float64[np.ndarray, "points 3"], pose: Pose) -> Float64[np.ndarray, "points 3"]:
    """Source coordinates as x forward, y left, z above the ground under the ego of ``pose``."""
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    x, y = points[:, 0] - pose.x, points[:, 1] - pose.y
    return np.stack([cos * x + sin * y, cos * y - sin * x, points[:, 2] - pose.ground], -1)


def agents_at(raw: RawScene, index: SegmentIndex, pose: Pose, radius: float, *, square: bool = False) -> Agents:
    """Agents of all our classes at the pose's step within ``radius`` metres (of the square's sides: ``square``)."""
    who = np.flatnonzero(raw.valid[:, pose.step] & (raw.types >= 0))
    local = to_pose_frame(raw.positions[who, pose.step], pose)
    distance = np.hypot(local[:, 0], local[:, 1])
    inside = (np.maximum(np.abs(local[:, 0]), np.abs(local[:, 1])) if square else distance) <= radius
    # The ego first whatever its distance, rounding included.
    order = np.argsort(np.where(who == pose.object, -1.0, distance), kind="stable")
    order = order[inside[order]]
    who, local = who[order], local[order]
    turn = raw.headings[who, pose.step] - pose.yaw
    speed = np.hypot(*raw.velocities[who, pose.step].T)
    states = np.concatenate(
        [local, speed[:, None], np.cos(turn)[:, None], np.sin(turn)[:, None], raw.sizes[who]], axis=1
    )
    near, _, _ = nearest_lane(index, raw.positions[who, pose.step, :2])
    off_road = (raw.types[who] == AgentType.VEHICLE) & (near > OFF_ROAD) & (who != pose.object)
    return Agents(states, raw.types[who], who, near, off_road)


def cut_tile(raw: RawScene, graph: LaneGraph, index: SegmentIndex, pose: Pose) -> Tile:
    """The evaluation tile at ``pose``: 64 m x 64 m around the ego (eval rule, steps 5-7), values as recorded."""
    pieces = ragged.clip(to_pose_frame(graph.points, pose), graph.offsets, CENTRED_WINDOW)
    lanes = ragged.resample(pieces, POINTS_PER_LANE)
    order = ragged.nearest_first(lanes)[:MAX_LANES]
    rank = np.full(len(lanes), -1)
    rank[order] = np.arange(len(order))
    edges = rank[ragged.piece_edges(pieces, graph.edges, graph.num_lanes)]
    edges = edges[(edges >= 0).all(-1)]
    agents = agents_at(raw, index, pose, TILE_SIZE / 2, square=True)
    moving = np.flatnonzero(agents.types != AgentType.STATIC)
    main, everything = np.zeros(len(agents.types), bool), np.zeros(len(agents.types), bool)
    main[moving[~agents.off_road[moving]][:MAX_AGENTS]] = True
    everything[moving[:MAX_AGENTS]] = True
    return Tile(lanes[order], edges, agents, main, everything)
