"""Lanes of logs and maps in npz files: all points as one ragged array, everything else as JSON."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from scjax.scene.map_lane import LaneNeighbor, MapLane

LANE_ARRAYS = {"lane_points": "f", "lane_offsets": "i"}
"""Name -> kind of its dtype."""


class LaneHeader(Struct):
    """A lane but its points."""

    id: str
    lane_type: str | None = None
    predecessors: tuple[str, ...] = ()
    successors: tuple[str, ...] = ()
    left_neighbors: tuple[LaneNeighbor, ...] = ()
    right_neighbors: tuple[LaneNeighbor, ...] = ()

    def with_points(self, points: np.ndarray) -> MapLane:
        """The lane with its points."""
        return MapLane(points=points, **{name: getattr(self, name) for name in LaneHeader.__struct_fields__})


def pack_lanes(lanes: Sequence[MapLane]) -> tuple[list[dict], dict[str, np.ndarray]]:
    """Headers of lanes for JSON, and the arrays of ``LANE_ARRAYS``."""
    headers = [{key: value for key, value in vars(lane).items() if key != "points"} for lane in lanes]
    points = np.concatenate([np.zeros((0, 3)), *(lane.points for lane in lanes)])
    return headers, {"lane_points": points, "lane_offsets": np.cumsum([0, *(len(lane.points) for lane in lanes)])}


def unpack_lanes(headers: Sequence[LaneHeader], arrays: dict[str, np.ndarray]) -> tuple[MapLane, ...]:
    """The lanes of ``pack_lanes``.

    Raises:
      ValueError: the arrays do not fit the headers.
    """
    offsets, points = arrays["lane_offsets"], arrays["lane_points"]
    if points.ndim != 2 or offsets.shape != (len(headers) + 1,):
        raise ValueError(f"lane_offsets {offsets.shape} and lane_points {points.shape} do not fit its lanes")
    if offsets[0] != 0 or offsets[-1] != len(points) or (np.diff(offsets) < 0).any():
        raise ValueError("lane_offsets do not cut lane_points into lanes")
    return tuple(
        header.with_points(points[start:end])
        for header, start, end in zip(headers, offsets[:-1], offsets[1:], strict=True)
    )
