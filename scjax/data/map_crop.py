"""A window of a map -> the ``Scene`` that networks read."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.data.crop import crop_scene
from scjax.data.lane_graph import LaneGraph, SegmentIndex, build_graph, index_segments, nearest_lane
from scjax.data.local_map import RADIUS, cut_local_map, simplify_graph
from scjax.data.tiles import Pose, pose_of
from scjax.scene import AgentType, Crop, Log, Map, Scene, map_to_log
from scjax.scene.arguments import finite_number, truth_value
from scjax.scene.limits import MAX_COORDINATE

NEAR = RADIUS + 70.0
"""m; lanes that come no nearer to a window do not count. Lanes in line with those inside may reach farther than it."""

_VIRTUAL_EGO = "ego of the window"


def crop_map(
    map: Map,
    x: float | None = None,
    y: float | None = None,
    yaw: float = 0.0,
    *,
    agent: str | None = None,
    crop: Crop = Crop.CENTERED,
    ego: bool = True,
    domain: int = 0,
    off_road: bool = False,
) -> Scene:
    """The unpadded NumPy scene of ``map`` around a place or an agent; quick on large maps too.

    Lanes are clipped, resampled to 20 points and linked as in records of the synthetic world: sharp bends are lanes of
    their own, since 20 points of a long lane could not show them. Values of agents that are not known are filled and
    flagged.

    Args:
      x, y, yaw: the origin of the scene and the direction of its x axis, in the frame of the map [m, rad].
      agent: id of the agent that becomes agent 0, instead of a place.
      crop: the window: centered, partitioned (lanes are cut at x = 0) or forward.
      ego: at a place, add a standing vehicle of unknown size as agent 0, since every scene of a network has an ego.
        Without it agent 0 is the nearest agent, if there is one.
      domain: index of the data set, for ``Scene.domain``.
      off_road: keep vehicles more than 2.5 m from every lane.

    Raises:
      ValueError: neither a place nor an agent of the map is given, or no lane for cars is in the window.
    """
    log, index, pose, graph = _window(map, x, y, yaw, agent, truth_value(ego, "ego"))
    local_map, _ = cut_local_map(log, simplify_graph(graph), index, pose)
    scene = crop_scene(local_map, crop, domain=domain, off_road=off_road, has_ego=pose.object_index >= 0)
    if not scene.num_lanes:
        place = f"x {pose.x:g}, y {pose.y:g}"
        raise ValueError(f"no lane for cars is in the window at {place}: choose a place on a road")
    return scene


def find_window(
    map: Map, x: float | None = None, y: float | None = None, yaw: float = 0.0, *, agent: str | None = None
) -> tuple[float, float, float, float]:
    """x, y, z of the origin of a scene of ``crop_map``, and the direction of its x axis, in the map's frame [m, rad].

    Arguments and errors as ``crop_map``.
    """
    _, _, pose, _ = _window(map, x, y, yaw, agent, True)
    return pose.x, pose.y, pose.ground, pose.yaw


def _window(
    map: Map, x: float | None, y: float | None, yaw: float, agent: str | None, ego: bool
) -> tuple[Log, SegmentIndex, Pose, LaneGraph]:
    """The log of what is near a place or an agent, its lanes, and the pose; object -1 if there is no ego."""
    if agent is None:
        if x is None or y is None:
            raise ValueError("x and y are missing: say where the scene is with x and y, or with agent")
        x, y = (finite_number(v, n, -MAX_COORDINATE, MAX_COORDINATE) for v, n in ((x, "x"), (y, "y")))
        yaw = finite_number(yaw, "yaw")
        if ego:
            map = _with_ego(map, x, y, yaw)
            agent = _VIRTUAL_EGO
    elif agent not in map.agent_ids:
        raise ValueError(
            f"agent is {agent!r}: the map has no such agent, only {', '.join(map.agent_ids[:10]) or 'none'}"
        )
    row = None if agent is None else map.agent_ids.index(agent)
    if row is not None:
        x, y = (float(value) for value in map.agents[row, :2])
    assert x is not None and y is not None
    log = map_to_log(near_map(map, x, y))
    if not log.lanes:
        raise ValueError(f"no lane is within {NEAR:g} m of x {x:g}, y {y:g}: choose a place of the extent {map.extent}")
    graph = build_graph(log, bends_alone=True)
    index = index_segments(graph)
    if row is not None:
        return log, index, pose_of(log, index, 0, row), graph
    ground = float(nearest_lane(index, np.array([[x, y]]))[2][0])
    return log, index, Pose(0, -1, x, y, yaw, ground, is_recorder=False), graph


def near_map(map: Map, x: float, y: float, distance: float = NEAR) -> Map:
    """``map`` with only the lanes whose bounding box comes within ``distance`` [m] of a place, and their signals.

    Agents stay; tiles, seams and routes do not.
    """
    if not map.lanes:
        return map
    points = np.concatenate([lane.points[:, :2] for lane in map.lanes])
    starts = np.cumsum([0, *(len(lane.points) for lane in map.lanes)])[:-1]
    low, high = np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)
    place = np.array([x, y])
    near = np.flatnonzero((low <= place + distance).all(-1) & (high >= place - distance).all(-1))
    lanes = tuple(map.lanes[row] for row in near)
    ids = {lane.id for lane in lanes}
    signals = np.array([row for row, item in enumerate(map.signal_lane_ids) if item in ids], int)
    return dataclasses.replace(
        map,
        lanes=lanes,
        signal_lane_ids=tuple(map.signal_lane_ids[row] for row in signals),
        signal_states=map.signal_states[signals],
        signal_positions=map.signal_positions[signals],
        tiles=(),
        seams=(),
        routes=(),
    )


def _with_ego(map: Map, x: float, y: float, yaw: float) -> Map:
    row = [x, y, np.nan, np.nan, np.cos(yaw), np.sin(yaw), np.nan, np.nan, np.nan]
    return dataclasses.replace(
        map,
        agent_ids=(*map.agent_ids, _VIRTUAL_EGO),
        agent_types=np.append(map.agent_types, np.int32(AgentType.VEHICLE)),
        agents=np.concatenate([map.agents, [row]]),
    )
