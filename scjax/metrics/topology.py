"""Topology of the lane graph: compact lanes, key points, hops between them, and the route of the ego.

Mode ``compat`` reproduces the reference code (Scenario Dreamer). There, grouping lane ends into key points is no
equivalence relation, and the route is the first of several equally short paths; both depend on the order of lanes.
Mode ``strict`` does not (metrics.md §1).
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from scjax.metrics.lines import polyline_lengths, resample_polylines
from scjax.scene import POINTS_PER_LANE, Link, Scene
from scjax.scene.lane_chains import merge_degree2_chains

Mode = Literal["compat", "strict"]

_HOP = 1e6  # metres: more than any route, so paths are compared by hops first, then by metres


class Lanes(NamedTuple):
    """Centerlines in xy, and sorted successor pairs (i, j): lane j follows lane i."""

    points: Float64[np.ndarray, "lanes points 2"]
    edges: Int[np.ndarray, "edges 2"]


def compact_lanes(scene: Scene) -> Lanes:
    """Lanes of one scene; chains without branches are merged_lines into one lane and resampled to 20 points."""
    mask = np.asarray(scene.lane_mask)
    points = np.asarray(scene.lanes, np.float64)[mask][..., :2]
    connections = np.argwhere(np.asarray(scene.links)[np.ix_(mask, mask)] == Link.PREDECESSOR)
    chains, edges = merge_degree2_chains(len(points), {(int(i), int(j)) for i, j in connections})
    if len(chains) == len(points):
        return Lanes(points, connections)
    merged_lines = [
        np.concatenate([points[chain[0]], *(points[lane][1:] for lane in chain[1:])])
        if len(chain) > 1
        else points[chain[0]]
        for chain in chains
    ]
    lines = [
        line if len(line) == POINTS_PER_LANE else resample_polylines(line[None], POINTS_PER_LANE)[0]
        for line in merged_lines
    ]
    return Lanes(np.stack(lines), np.unique(edges, axis=0))


def key_points(lanes: Lanes, mode: Mode) -> Bool[np.ndarray, "key_points key_points"]:
    """Adjacency of the key points: lane l leads from the point of its start to the point of its end."""
    label = _compat_labels(lanes) if mode == "compat" else _strict_labels(lanes)
    _, first, index = np.unique(label, return_index=True, return_inverse=True)
    index = np.argsort(np.argsort(first))[index]  # number key points by their first end
    adjacency = np.zeros((len(first), len(first)), bool)
    adjacency[index[0::2], index[1::2]] = True
    return adjacency


def degrees(adjacency: Bool[np.ndarray, "n n"]) -> Int[np.ndarray, " n"]:
    """Number of lanes in and out of every key point; a loop counts twice."""
    return adjacency.sum(0) + adjacency.sum(1)


def reach_and_hops(
    adjacency: Bool[np.ndarray, "n n"],
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " reachable_pairs"]]:
    """Number of key points that each one reaches, and the hops of a shortest path per reachable ordered pair."""
    # Breadth-first search from all points at once: a tile has dozens of points, a few hops apart.
    hops = np.zeros(adjacency.shape, int)
    visited, front, step = np.eye(len(adjacency), dtype=bool), adjacency, np.float32(1) * adjacency
    for hop in range(1, len(adjacency)):
        front = front & ~visited
        if not front.any():
            break
        hops[front] = hop
        visited = visited | front
        front = (np.float32(1) * front) @ step > 0
    return (hops > 0).sum(1), hops[hops > 0]


def route_length(lanes: Lanes, mode: Mode) -> float:
    """Length of the longest route ahead of the ego [m]; NaN without lanes.

    The route starts at the lane point nearest to the origin and follows that lane to its end. From there, paths with
    the fewest lanes lead to every reachable lane. Among paths with equally many lanes, ``strict`` takes the shortest
    and ``compat`` the first that the reference search meets.
    """
    if not len(lanes.points):
        return float("nan")
    distance = np.linalg.norm(lanes.points, axis=-1)
    ego = int(distance.min(1).argmin())
    metres = polyline_lengths(lanes.points)
    first = float(polyline_lengths(lanes.points[ego : ego + 1, int(distance[ego].argmin()) :])[0])
    count = len(metres)
    if mode == "compat":
        after, before = _neighbors(lanes.edges, count), _neighbors(lanes.edges[:, ::-1], count)
        paths = (_meeting_path(after, before, ego, goal) for goal in range(count) if goal != ego)
        return max([first, *(first + float(metres[path[1:]].sum()) for path in paths if path)])
    weight = csr_array((_HOP + metres[lanes.edges[:, 1]], tuple(lanes.edges.T)), shape=(count, count))
    way = dijkstra(weight, indices=ego)
    way = way[np.isfinite(way)]
    return first + float((way - _HOP * np.floor(way / _HOP)).max())


def endpoint_gaps(lanes: Lanes) -> Float64[np.ndarray, " edges"]:
    """Distance from the end of lane i to the start of lane j, for every successor pair [m]."""
    i, j = lanes.edges.T
    return np.linalg.norm(lanes.points[i, -1] - lanes.points[j, 0], axis=-1)


def _strict_labels(lanes: Lanes) -> Int[np.ndarray, " ends"]:
    """A label for the start (2 l) and end (2 l + 1) of every lane; ends connected by edges share one."""
    parent = list(range(2 * len(lanes.points)))

    def root(end: int) -> int:
        while parent[end] != end:
            parent[end] = end = parent[parent[end]]
        return end

    for i, j in lanes.edges.tolist():
        parent[root(2 * i + 1)] = root(2 * j)
    return np.array([root(end) for end in range(len(parent))], int)


def _compat_labels(lanes: Lanes) -> Int[np.ndarray, " ends"]:
    """As ``_strict_labels``, but an edge between two groups adds its ends to both; the last group wins."""
    groups: list[set[int]] = []
    for i, j in lanes.edges.tolist():
        ends = {2 * i + 1, 2 * j}
        touched = [group for group in groups if group & ends]
        for group in touched:
            group |= ends
        if not touched:
            groups.append(ends)
    label = np.arange(2 * len(lanes.points))
    for number, group in enumerate(groups):
        label[list(group)] = len(label) + number
    return label


def _neighbors(edges: np.ndarray, count: int) -> list[list[int]]:
    neighbors: list[list[int]] = [[] for _ in range(count)]
    for i, j in sorted(map(tuple, edges.tolist())):
        neighbors[i].append(j)
    return neighbors


def _meeting_path(after: list[list[int]], before: list[list[int]], start: int, goal: int) -> list[int]:
    """A path with the fewest lanes from ``start`` to ``goal``, by bidirectional search; empty if there is none.

    The side with fewer open lanes (on a tie, the start) advances by one level, in the order of discovery. The search
    ends at the first lane known to both sides. This decides between equally short paths.
    """
    came: dict[int, int] = {start: start}
    goes: dict[int, int] = {goal: goal}
    ahead, behind = [start], [goal]
    while ahead and behind:
        forward = len(ahead) <= len(behind)
        level, known, others, steps = (ahead, came, goes, after) if forward else (behind, goes, came, before)
        fresh = []
        for lane in level:
            for following in steps[lane]:
                if following not in known:
                    known[following] = lane
                    fresh.append(following)
                if following in others:
                    return _joined(came, goes, following)
        if forward:
            ahead = fresh
        else:
            behind = fresh
    return []


def _joined(came: dict[int, int], goes: dict[int, int], middle: int) -> list[int]:
    path = [middle]
    while came[path[0]] != path[0]:
        path.insert(0, came[path[0]])
    while goes[path[-1]] != path[-1]:
        path.append(goes[path[-1]])
    return path
