"""Distances to the lanes of whole maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from scjax.scene import MapLane
from scjax.scene.map_lane import NO_CAR_LANE_TYPES

OFF_ROAD = 2.5
"""A center that is farther from every centerline is off the road [m]."""

_SPACING = 1.0  # m between the points of the search tree, at most


class RoadDistance:
    """Answers how far points are from the nearest centerline of a lane for cars; heights do not matter."""

    def __init__(self, lanes: Sequence[MapLane]):
        from scipy.spatial import KDTree

        lines = [lane.points[:, :2] for lane in lanes if lane.lane_type not in NO_CAR_LANE_TYPES]
        lines = [_subdivide(line) for line in lines]
        self._points = np.concatenate([np.zeros((0, 2)), *lines])
        starts = np.cumsum([0, *(len(line) for line in lines)])
        count = len(self._points)
        before, after = np.arange(count) - 1, np.arange(count) + 1
        before[starts[:-1]] = starts[:-1]
        after[starts[1:] - 1] = starts[1:] - 1
        self._neighbors = (before, after)
        self._tree = KDTree(self._points) if count else None

    @property
    def has_lanes(self) -> bool:
        """Whether there is any lane for cars."""
        return self._tree is not None

    def __call__(self, points: Float64[np.ndarray, "points 2"]) -> Float64[np.ndarray, " points"]:
        """Distance of each point to the nearest centerline [m]; inf without lanes.

        The nearest point of the tree chooses the segments. Beside a lane that is hardly nearer than another one, the
        choice may be wrong by the little that a point 0.5 m along the lane adds to the distance.
        """
        if self._tree is None or not len(points):
            return np.full(len(points), np.inf)
        _, nearest = self._tree.query(points)
        start = self._points[nearest]
        distance = np.full(len(points), np.inf)
        for neighbor in self._neighbors:
            along = self._points[neighbor[nearest]] - start
            offset = points - start
            square = (along**2).sum(-1)
            share = np.clip((offset * along).sum(-1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
            distance = np.minimum(distance, np.hypot(*(offset - share[:, None] * along).T))
        return distance


def _subdivide(line: np.ndarray) -> np.ndarray:
    """All points of a line, and more where they are far apart [points, 2]."""
    steps = np.diff(line, axis=0)
    pieces = np.maximum(np.ceil(np.hypot(*steps.T) / _SPACING), 1).astype(int)
    segment = np.repeat(np.arange(len(steps)), pieces)
    number = np.arange(len(segment)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    return np.concatenate([line[segment] + (number / pieces[segment])[:, None] * steps[segment], line[-1:]])
