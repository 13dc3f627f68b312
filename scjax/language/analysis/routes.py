"""Ways along lanes over their links: the straightest one, and all that can be reached."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64

from scjax.language.analysis.lane_lines import LaneLines
from scjax.scene.angles import wrap_to_pi

_LOOK_AHEAD = 15  # points of a lane, at most, over which its direction is compared


@dataclasses.dataclass(frozen=True)
class Route:
    """A way from one point of a lane on.

    Attributes:
      points: x, y, z [m] and the heading of the lane [rad], from the start on.
      distance: from the start to every point [m].
      lanes: lanes on the way, the first included.
      starts: distance at which every lane of ``lanes`` begins; 0 for the first.
    """

    points: Float64[np.ndarray, "points 4"]
    distance: Float64[np.ndarray, " points"]
    lanes: tuple[int, ...]
    starts: tuple[float, ...]

    @property
    def length(self) -> float:
        """Of the whole way [m]."""
        return float(self.distance[-1])


def straightest_route(lines: LaneLines, lane: int, point: int, reach: float, *, ahead: bool = True) -> Route:
    """The way of least turn from a lane's point, ``reach`` metres long or up to where lanes end."""
    table = lines.next if ahead else lines.previous
    parts, lanes, starts = [_part(lines, lane, point, ahead)], [lane], [0.0]
    length = _span(parts[0])
    while length < reach:
        choices = [k for k in table[lanes[-1]] if k not in lanes]
        if not choices:
            break
        heading = parts[-1][-1, 3]
        lane = min(choices, key=lambda k: _deviation(lines, k, heading, ahead))
        part = _part(lines, lane, 0 if ahead else int(lines.count[lane]) - 1, ahead)
        starts.append(length)
        length += float(np.hypot(*(part[0, :2] - parts[-1][-1, :2]))) + _span(part)
        lanes.append(lane)
        parts.append(part)
    points = np.concatenate(parts)
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
    inside = distance <= reach
    return Route(points[inside], distance[inside], tuple(lanes), tuple(starts))


def _part(lines: LaneLines, lane: int, point: int, ahead: bool) -> np.ndarray:
    """Points of one lane with headings, from ``point`` on [n, 4]."""
    rows = slice(point, lines.count[lane]) if ahead else slice(point, None, -1)
    return np.concatenate([lines.points[lane, rows], lines.headings[lane, rows, None]], 1)


def _span(part: np.ndarray) -> float:
    return float(np.hypot(*np.diff(part[:, :2], axis=0).T).sum())


def _deviation(lines: LaneLines, lane: int, heading: float, ahead: bool) -> float:
    """How far a lane turns off ``heading`` [rad]."""
    last = int(lines.count[lane]) - 1
    point = min(_LOOK_AHEAD, last) if ahead else max(0, last - _LOOK_AHEAD)
    return abs(float(wrap_to_pi(lines.headings[lane, point] - heading)))


def pose_after(lines: LaneLines, lane: int, reach: float, *, ahead: bool) -> tuple[np.ndarray, float]:
    """Pose (x, y, heading) ``reach`` metres from a lane's start (its end, if not ``ahead``), and how far that is.

    Where lanes end earlier, the pose is that of the end.
    """
    table = lines.next if ahead else lines.previous
    visited, travelled = {lane}, 0.0
    while True:
        left = reach - travelled
        if lines.length[lane] >= left:
            step = round(left / lines.spacing[lane])
            travelled = reach
            break
        travelled += float(lines.length[lane])
        step = int(lines.count[lane]) - 1
        heading = float(lines.headings[lane, step if ahead else 0])
        choices = [k for k in table[lane] if k not in visited]
        if not choices:
            break
        lane = min(choices, key=lambda k: _deviation(lines, k, heading, ahead))
        visited.add(lane)
    point = step if ahead else int(lines.count[lane]) - 1 - step
    return np.array([*lines.points[lane, point, :2], lines.headings[lane, point]]), travelled


def reachable_lanes(lines: LaneLines, lane: int, point: int, reach: float) -> dict[int, float]:
    """Lanes that begin ahead of a lane's point, with the least distance to their start [m], nearest first."""
    distances: dict[int, float] = {}
    frontier = [(float(lines.length[lane] - point * lines.spacing[lane]), lane)]
    while frontier:
        distance, last = min(frontier)
        frontier.remove((distance, last))
        if distance > reach:
            break
        for k in lines.next[last]:
            if k != lane and k not in distances:
                distances[k] = distance
                frontier.append((distance + float(lines.length[k]), k))
    return distances
