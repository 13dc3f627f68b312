"""Intersections: clusters of lane crossings with their arms.

Arms are counted by the headings with which lanes enter and leave, not by the positions where they do. On wide arms
positions vary by 25 degrees, headings by 5; connectors have the headings of arms outside the window.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.language.road import Road, wrap_to_pi

IntersectionType = Literal["four-way", "T", "complex"]
EgoSide = Literal["ahead", "behind", "left", "right", "inside"]

_CROSSING_ANGLES = np.deg2rad((35.0, 145.0))  # between two lanes that cross
_SIBLING_ANGLES = np.deg2rad((60.0, 120.0))  # between lanes that share a predecessor or a successor
_LEVEL_HEIGHT = 3.0  # m between lanes that pass over each other
_CROSSING_DISTANCE = 12.0  # m between neighboring crossings of one intersection
_MARGIN = 10.0  # m from the outermost crossing to the end of the intersection
_MAX_CONNECTOR_LENGTH = 45.0  # m
_MIN_CONNECTOR_TURN = 0.5  # rad
_ARM_GAP = np.deg2rad(28.0)
_MIN_ARM_HEADINGS, _MANY_HEADINGS = 2, 10  # an arm needs two headings where an intersection has ten or more
_MAX_END_TURN = 0.12  # rad over the last tenth of a lane that the window cuts
_BORDER = 31.0  # m
_MIN_RAMP_RADIUS = 25.0  # m, larger turn radii belong to interchanges
_MIN_TURN, _MAX_RAMP_TURN = 0.35, 1.2  # rad
_POINT_STRIDE = 4  # in the search for crossings
_INSIDE_MARGIN = 6  # m


@dataclasses.dataclass(frozen=True)
class Intersection:
    """Crossing lanes in one place.

    Attributes:
      center, radius: disc that holds the crossings, with a margin of 10 m [m].
      members: lanes that cross or connect in it.
      arms: directions of the roads, seen from the intersection [rad].
      crossings: number of pairs of lanes that cross.
    """

    center: np.ndarray
    radius: float
    members: tuple[int, ...]
    arms: tuple[float, ...]
    crossings: int

    @property
    def type(self) -> IntersectionType | None:
        """Type by the number of arms; None for fewer than three, where no roads cross."""
        if len(self.arms) < 3:
            return None
        return "T" if len(self.arms) == 3 else "four-way" if len(self.arms) == 4 else "complex"

    @property
    def distance(self) -> float:
        """From the ego to the center [m]."""
        return float(np.hypot(*self.center))

    @property
    def side(self) -> EgoSide:
        """Position relative to the ego."""
        if self.distance < self.radius - _INSIDE_MARGIN:
            return "inside"
        return _quadrant(self.center)


def find_intersections(road: Road) -> tuple[list[Intersection], int]:
    """Intersections with three or more arms, and the number of bridges.

    Lanes of untrained models cross each other more than once on average; such a tangle has no intersections.

    Returns:
      Intersections, those with most crossings first; number of pairs of lanes that cross on different levels.
    """
    positions, pairs, bridges = _crossings(road)
    if not len(positions) or len(positions) > len(road) * (len(road) - 1) // 2:
        return [], bridges
    is_near = np.linalg.norm(positions[:, None] - positions[None], axis=-1) < _CROSSING_DISTANCE
    from scipy.sparse import csr_array  # slow to import
    from scipy.sparse.csgraph import connected_components

    cluster = connected_components(csr_array(is_near), directed=False)[1]
    intersections = []
    for number in range(cluster.max() + 1):
        points = positions[cluster == number]
        center = points.mean(0)
        radius = float(np.linalg.norm(points - center, axis=-1).max()) + _MARGIN
        members = set(pairs[cluster == number].ravel().tolist()) | _connectors(road, center, radius)
        arms = _arms(road, members, center, radius)
        intersection = Intersection(center, radius, tuple(sorted(members)), arms, len(points))
        if intersection.type is not None and not _is_interchange(road, members):
            intersections.append(intersection)
    return sorted(intersections, key=lambda item: (-item.crossings, item.distance, *item.center)), bridges


def _quadrant(position: np.ndarray) -> Literal["ahead", "behind", "left", "right"]:
    bearing = np.arctan2(position[1], position[0])
    if abs(bearing) <= np.pi / 4:
        return "ahead"
    if abs(bearing) >= 3 * np.pi / 4:
        return "behind"
    return "left" if bearing > 0 else "right"


def _crossings(road: Road) -> tuple[np.ndarray, np.ndarray, int]:
    """Positions [n, 2] and lanes [n, 2] of crossings; number of pairs of lanes that cross on different levels."""
    if len(road) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2), int), 0
    line, z = road.points[:, ::_POINT_STRIDE], road.z[:, ::_POINT_STRIDE]
    i, j = np.triu_indices(len(road), 1)
    low, high = line.min(1), line.max(1)
    boxes_overlap = ((low[i] <= high[j]) & (low[j] <= high[i])).all(-1)
    i, j = i[boxes_overlap], j[boxes_overlap]
    # Every segment a + s da of lane i with every segment b + t db of lane j.
    starts, steps = line[:, :-1], np.diff(line, axis=1)
    a, b = starts[i][:, :, None], starts[j][:, None]
    da, db = steps[i][:, :, None], steps[j][:, None]
    cross = da[..., 0] * db[..., 1] - da[..., 1] * db[..., 0]
    offset = b - a
    divisor = np.where(np.abs(cross) > 1e-9, cross, np.inf)
    s = (offset[..., 0] * db[..., 1] - offset[..., 1] * db[..., 0]) / divisor
    t = (offset[..., 0] * da[..., 1] - offset[..., 1] * da[..., 0]) / divisor
    angle = np.abs(np.arctan2(cross, (da * db).sum(-1)))
    siblings = np.array([_are_siblings(road, int(m), int(n)) for m, n in zip(i, j, strict=True)], bool)
    min_angle = np.where(siblings, _SIBLING_ANGLES[0], _CROSSING_ANGLES[0])[:, None, None]
    max_angle = np.where(siblings, _SIBLING_ANGLES[1], _CROSSING_ANGLES[1])[:, None, None]
    intersects = (np.abs(cross) > 1e-9) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    pair, m, n = np.nonzero(intersects & (angle >= min_angle) & (angle <= max_angle))
    height = np.abs(z[i[pair], m] - z[j[pair], n])
    is_level = ~(height > _LEVEL_HEIGHT)  # an unknown height (NaN) counts as level
    positions = starts[i[pair], m] + s[pair, m, n][:, None] * steps[i[pair], m]
    bridges = len(set(pair[~is_level].tolist()))
    return positions[is_level], np.stack([i[pair], j[pair]], 1)[is_level], bridges


def _are_siblings(road: Road, i: int, j: int) -> bool:
    """Whether two lanes share a predecessor or a successor."""
    predecessors = set(road.predecessors[i]) & set(road.predecessors[j])
    return bool(predecessors or set(road.successors[i]) & set(road.successors[j]))


def _connectors(road: Road, center: np.ndarray, radius: float) -> set[int]:
    """Short turning lanes in the disc that start at a fork or end at a merge, since right turns cross no lane."""
    inside = (np.linalg.norm(road.points - center, axis=-1) < radius).any(1)
    turning = inside & (road.length < _MAX_CONNECTOR_LENGTH) & (np.abs(road.turn) > _MIN_CONNECTOR_TURN)
    return {
        int(lane)
        for lane in np.flatnonzero(turning)
        if any(len(road.successors[k]) > 1 for k in road.predecessors[lane])
        or any(len(road.predecessors[k]) > 1 for k in road.successors[lane])
    }


def _arms(road: Road, members: set[int], center: np.ndarray, radius: float) -> tuple[float, ...]:
    """Directions of the roads that meet, seen from the intersection [rad].

    Among many headings a single one is no road: the disc or the window cuts a connector within its turn, or a model
    drew the end of a lane askew.
    """
    directions = []
    for lane in members:
        inside = np.flatnonzero(np.linalg.norm(road.points[lane] - center, axis=-1) < radius)
        if not len(inside):
            continue
        entry, exit_ = int(inside[0]), int(inside[-1])
        headings = road.headings[lane]
        entry_direction = headings[min(entry, len(headings) - 1)] + np.pi
        exit_direction = headings[max(exit_ - 1, 0)]
        for point, end, direction in ((entry, 0, entry_direction), (exit_, 1, exit_direction)):
            at_border = np.abs(road.points[lane, point]).max() > _BORDER
            if not (at_border and road.end_turns[lane, end] > _MAX_END_TURN):
                directions.append(float(wrap_to_pi(direction)))
    min_headings = _MIN_ARM_HEADINGS if len(directions) >= _MANY_HEADINGS else 1
    clusters = _circular_clusters(directions)
    return tuple(
        float(np.arctan2(np.sin(cluster).mean(), np.cos(cluster).mean()))
        for cluster in clusters
        if len(cluster) >= min_headings
    )


def _circular_clusters(angles: list[float]) -> list[np.ndarray]:
    """Groups of angles [rad], separated by gaps of more than 28 degrees."""
    if not angles:
        return []
    ordered = np.sort(np.array(angles))
    gaps = np.append(np.diff(ordered), ordered[0] + 2 * np.pi - ordered[-1])
    # Start after the largest gap, so that no group is cut at +-pi.
    ordered = np.roll(ordered, -1 - int(gaps.argmax()))
    return np.split(ordered, np.flatnonzero(np.diff(ordered) % (2 * np.pi) > _ARM_GAP) + 1)


def _is_interchange(road: Road, members: set[int]) -> bool:
    """Whether all turning lanes have the radius of a ramp: a T by its arms, but in fact a merge."""
    turning = [lane for lane in members if abs(road.turn[lane]) > _MIN_TURN]
    if not turning:
        return False
    radii = [road.length[lane] / abs(road.turn[lane]) for lane in turning]
    return bool(min(radii) > _MIN_RAMP_RADIUS and all(abs(road.turn[lane]) < _MAX_RAMP_TURN for lane in turning))
