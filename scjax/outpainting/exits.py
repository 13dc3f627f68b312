"""Where a map can grow: open ends that a route reaches, and the window beyond each."""

from __future__ import annotations

import collections
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.outpainting.coverage import AHEAD, Coverage, OpenEnd
from scjax.outpainting.window import HALF, WindowPose
from scjax.scene import Map
from scjax.scene.angles import wrap_to_pi
from scjax.scene.map import following_ids
from scjax.scene.map_lane import NO_CAR_LANE_TYPES
from scjax.scene.polyline import cumulative_length, spread_points

MAX_COVERED = 0.3
"""Share of the front half of a new window that may be covered."""

_BACK = 0.5  # m behind the end, where the window's center is
_AVERAGED = 3.0  # m over which the direction is averaged


class RoadExit(NamedTuple):
    """An open end that a route can reach.

    Attributes:
      lane_ids: from the route's last lane to the lane with the open end.
      pose: of the window beyond it.
      covered: share of that window's front half that is covered.
    """

    lane_ids: tuple[str, ...]
    pose: WindowPose
    covered: float


def find_exits(map: Map, first: str) -> list[RoadExit]:
    """All open ends at the border of the covered ground that can be reached from lane ``first``, nearest first.

    Along successors where these reach any, else also by changes to lanes beside.
    """
    coverage = Coverage(map)
    ends = {end.lane_id: end for end in coverage.open_ends(map) if end.at_border and not end.is_start}
    lanes = map.lane_by_id
    for follow in (lambda lane: lane.successors, following_ids):
        came_from, queue = {first: ""}, collections.deque([first])
        while queue:
            item = queue.popleft()
            for other in follow(lanes[item]):
                if other in lanes and other not in came_from:
                    came_from[other] = item
                    queue.append(other)
        reached = [item for item in came_from if item in ends]
        if reached:
            break
    exits = []
    for item in reached:
        way = [item]
        while came_from[way[-1]]:
            way.append(came_from[way[-1]])
        pose = pose_beyond(lanes[item].points)
        exits.append(RoadExit(tuple(reversed(way)), pose, coverage.share_ahead(pose.x, pose.y, pose.yaw)))
    return exits


def pose_beyond(points: Float64[np.ndarray, "points 3"], back: float = 0.0) -> WindowPose:
    """The window at the end of a lane, half a meter behind it, or ``back`` [m] more."""
    arc = cumulative_length(points)

    def at(distance: float) -> np.ndarray:
        return np.array([np.interp(max(distance, 0.0), arc, column) for column in points.T])

    place, before = at(arc[-1] - _BACK - back), at(arc[-1] - _BACK - back - _AVERAGED)
    x, y = (place - before)[:2]
    if np.hypot(x, y) < 1e-6:
        x, y = (points[-1] - points[0])[:2]
    return WindowPose(float(place[0]), float(place[1]), float(np.nan_to_num(place[2])), float(np.arctan2(y, x)))


def start_lane(map: Map, x: float, y: float, yaw: float) -> str:
    """The lane for cars nearest to a place among those within 60 degrees of a direction.

    Raises:
      ValueError: there is none within 5 m.
    """
    best, nearest = "", 5.0
    for lane in map.lanes:
        if lane.lane_type in NO_CAR_LANE_TYPES:
            continue
        middle, steps = (lane.points[1:, :2] + lane.points[:-1, :2]) / 2, np.diff(lane.points[:, :2], axis=0)
        distance = np.hypot(*(middle - np.array([x, y])).T) - np.hypot(*steps.T) / 2
        turn = np.abs(wrap_to_pi(np.arctan2(steps[:, 1], steps[:, 0]) - yaw))
        distance = np.where(turn < np.deg2rad(60.0), distance, np.inf)
        if len(distance) and distance.min() < nearest:
            best, nearest = lane.id, float(distance.min())
    if not best:
        raise ValueError(f"no lane leads on from x {x:g}, y {y:g} in direction {yaw:g} rad: choose a place on a road")
    return best


def choose_exit(
    exits: Sequence[RoadExit],
    rng: np.random.Generator,
    *,
    yaw: float,
    way: str | Float64[np.ndarray, "points 2"],
) -> RoadExit | None:
    """The next exit of a route, of those beyond which there is room; None: there is none.

    Args:
      yaw: direction of the route so far [rad].
      way: "straight" (the least turn), "random", or points that the route shall pass [m].
    """
    free = [one for one in exits if one.covered <= MAX_COVERED]
    if not free:
        return None
    if isinstance(way, str):
        if way == "random":
            return free[int(rng.integers(len(free)))]
        return min(free, key=lambda one: abs(wrap_to_pi(one.pose.yaw - yaw)))
    return min(free, key=lambda one: _off_way(one.pose, way))


def _off_way(pose: WindowPose, way: Float64[np.ndarray, "points 2"]) -> float:
    """Distance of the middle of the new half from a way, less the progress along it [m]."""
    place = np.array([pose.x + 16 * np.cos(pose.yaw), pose.y + 16 * np.sin(pose.yaw)])
    line = spread_points(way)
    distance = np.hypot(*(line - place).T)
    nearest = int(distance.argmin())
    return float(distance[nearest] - nearest)


def ends_in_window(ends: Sequence[OpenEnd], pose: WindowPose) -> tuple[OpenEnd, ...]:
    """The open ends at the border of the covered ground that lie in a window, or lead into it."""
    result = []
    for end in ends:
        x, y, _ = pose.to_window(np.nan_to_num(end.place))
        if end.at_border and max(abs(x), abs(y)) < HALF + AHEAD:
            result.append(end)
    return tuple(result)
