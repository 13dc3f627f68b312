"""One lane of a map, as logs and maps hold it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.scene.checks import check_known, check_unique
from scjax.scene.limits import MAX_COORDINATE

NO_CAR_LANE_TYPES = ("bike_lane", "undefined", "not_for_cars")
"""Types of lanes on which cars do not drive."""


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
      lane_type: freeway, surface_street, bike_lane, bus_lane, undefined, not_for_cars, or None where not recorded.
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


def check_lanes(lanes: Sequence[MapLane]) -> None:
    """The invariants of the lanes of a log or map.

    A lane may consist of one point, or of several at one place: sources have such lanes, and the lane graph leaves them
    out. Connections may name lanes that are not there, or contradict the geometry: the lane graph refuses and counts
    them.

    Raises:
      ValueError: naming the first lane at fault, what is wrong and how to mend it.
    """
    for lane in lanes:
        if lane.points.ndim != 2 or lane.points.shape[-1] != 3 or not len(lane.points):
            raise ValueError(
                f"lanes: lane {lane.id} has points of shape {lane.points.shape}: give at least one point of x, y, z"
            )
        if not (np.abs(lane.points[:, :2]) < MAX_COORDINATE).all():
            raise ValueError(f"lanes: lane {lane.id} has NaN or absurd coordinates: remove those points")
        unknown = np.isnan(lane.points[:, 2])
        if unknown.any() and not unknown.all():
            raise ValueError(f"lanes: lane {lane.id} has z at some points only: fill it, or set all to NaN")
        check_known(f"lanes: z of lane {lane.id}", lane.points[:, 2])
    check_unique("lanes", [lane.id for lane in lanes])
