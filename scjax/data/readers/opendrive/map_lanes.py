"""A road map -> the lanes and signals of a log."""

from __future__ import annotations

import numpy as np

from scjax.data.readers.opendrive.lane_lines import LaneKey, LaneLine
from scjax.data.readers.opendrive.road_map import RoadMap
from scjax.data.readers.vocabulary import NOT_FOR_CARS
from scjax.scene import LaneNeighbor, Log, LogMetadata, Map, MapLane, Signal, map_to_log


def road_map_log(road_map: RoadMap, metadata: LogMetadata) -> Log:
    """A log of one step without objects; the states of its signals are unknown.

    Lanes of type "none" are left out. Sidewalks, shoulders and the like are "not_for_cars".

    Raises:
      ValueError: cars can drive on none of its lanes.
    """
    lanes = tuple(_map_lane(line, road_map) for line in road_map.lines.values() if line.lane.type != "none")
    if all(lane.lane_type == NOT_FOR_CARS for lane in lanes):
        raise ValueError("it has no lane that is driven on: leave this file out")
    signals = [key for key in road_map.signal_lanes if road_map.lines[key].lane.type != "none"]
    starts = [road_map.lines[key].points[0] for key in signals]
    return map_to_log(
        Map(
            lanes=lanes,
            signal_lane_ids=tuple(map(str, signals)),
            signal_states=np.full(len(signals), Signal.UNKNOWN, np.int8),
            signal_positions=np.array(starts, np.float64).reshape(-1, 3),
            metadata=metadata,
        )
    )


def _map_lane(line: LaneLine, road_map: RoadMap) -> MapLane:
    left, right = _neighbors(line, road_map)
    return MapLane(
        id=str(line.key),
        lane_type=road_map.lane_types[line.key],
        points=line.points,
        predecessors=tuple(map(str, road_map.predecessors.get(line.key, ()))),
        successors=tuple(map(str, road_map.successors.get(line.key, ()))),
        left_neighbors=left,
        right_neighbors=right,
    )


def _neighbors(line: LaneLine, road_map: RoadMap) -> tuple[tuple[LaneNeighbor, ...], tuple[LaneNeighbor, ...]]:
    """Lanes of the section on the left and right that traffic uses in the same direction."""
    sides: tuple[list[LaneNeighbor], list[LaneNeighbor]] = ([], [])
    road, section, lane = line.key
    for number in (lane - 1, lane + 1):
        other = road_map.lines.get(LaneKey(road, section, number))
        if other is None or number * lane < 0 or other.lane.forward != line.lane.forward:
            continue
        if NOT_FOR_CARS in (road_map.lane_types[line.key], road_map.lane_types[other.key]):
            continue
        is_left = (number > lane) == line.lane.forward  # ids grow to the left of the reference line
        span = (0, len(line.points) - 1, 0, len(other.points) - 1)
        sides[0 if is_left else 1].append(LaneNeighbor(str(other.key), *span))
    return tuple(sides[0]), tuple(sides[1])
