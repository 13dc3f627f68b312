"""One lane of a recorded map."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64


class LaneNeighbor(NamedTuple):
    """A lane beside another one, and where they run side by side (field names of the Waymo map format).

    The four indices count points of the lane itself and of its neighbor. All are None where the source does not say.
    """

    lane_id: str
    self_start_index: int | None = None
    self_end_index: int | None = None
    neighbor_start_index: int | None = None
    neighbor_end_index: int | None = None


@dataclasses.dataclass(frozen=True)
class MapLane:
    """One lane as recorded; ids are strings whatever the source uses, and may name lanes that the map lacks.

    Attributes:
      id: unique within the map.
      lane_type: freeway, surface_street, bike_lane, bus_lane, undefined, or None where not recorded.
      points: centerline in driving direction [m]; z is NaN at all points where it was not recorded.
      predecessors, successors: ids of the lanes before and after it; empty where the source has no topology.
      left_neighbors, right_neighbors: adjacent lanes; sources may list oncoming ones too.
    """

    id: str
    lane_type: str | None
    points: Float64[np.ndarray, "points 3"]
    predecessors: tuple[str, ...] = ()
    successors: tuple[str, ...] = ()
    left_neighbors: tuple[LaneNeighbor, ...] = ()
    right_neighbors: tuple[LaneNeighbor, ...] = ()
