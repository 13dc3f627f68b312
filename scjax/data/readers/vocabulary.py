"""Words for classes of objects, states of signals and types of lanes in the field's formats, in one table each.

Formats: Waymo, MetaDrive and ScenarioNet, nuScenes, nuPlan, Argoverse 2, CommonRoad, OpenDRIVE, SUMO. A word outside
the tables is counted by the reader; it never becomes "unknown" in silence.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from typing import TypeVar

from scjax.scene import OTHER_OBJECT, AgentType, Signal

V = TypeVar("V")

BICYCLE = -2
"""Class of a bicycle of which the source does not say whether it is ridden: its motion decides."""

_PREFIXES = ("lane_state_", "traffic_light_", "type_", "lane_type_", "object_type_")


def _table(rows: Mapping[V, str]) -> dict[str, V]:
    return {word: value for value, words in rows.items() for word in words.split()}


OBJECT_WORDS: dict[str, int] = _table(
    {
        AgentType.VEHICLE.value: "vehicle car vehicle.car passenger taxi truck vehicle.truck truck_cab box_truck bus "
        "vehicle.bus vehicle.bus.rigid vehicle.bus.bendy school_bus articulated_bus coach trailer vehicle.trailer "
        "vehicular_trailer vehicle.construction vehicle.emergency.police vehicle.emergency.ambulance emergency "
        "large_vehicle regular_vehicle delivery motorcycle vehicle.motorcycle motorcyclist moped priority_vehicle "
        "parked_vehicle ego sdc ego_vehicle van suv pickup evehicle hov private authority army vip custom1 custom2 "
        "message_board_trailer traffic_light_trailer railed_vehicle tram",
        AgentType.PEDESTRIAN.value: "pedestrian human.pedestrian human.pedestrian.adult human.pedestrian.child "
        "human.pedestrian.construction_worker human.pedestrian.police_officer human.pedestrian.personal_mobility "
        "human.pedestrian.stroller human.pedestrian.wheelchair person walker stroller wheelchair official_signaler",
        AgentType.CYCLIST.value: "cyclist bicyclist wheeled_rider rider",
        BICYCLE: "bicycle bicycle_parked_or_ridden vehicle.bicycle wheeled_device bike",
        AgentType.STATIC.value: "static traffic_cone cone construction_cone barrier traffic_barrier movable_object "
        "movable_object.barrier movable_object.trafficcone movable_object.debris movable_object.pushable_pullable "
        "static_object.bicycle_rack construction_barrel bollard sign stop_sign czone_sign traffic_object construction "
        "construction_zone riderless_bicycle mobile_pedestrian_crossing_sign obstacle static_obstacle",
        OTHER_OBJECT: "other unknown unset animal dog background generic_object train rail rail_urban rail_electric "
        "rail_fast ship aircraft building pillar median_strip road_boundary traffic_light",
    }
)

SIGNAL_WORDS: dict[str, Signal] = _table(
    {
        Signal.UNKNOWN: "unknown none off inactive o off_blinking off_no_signal",
        Signal.GO: "go arrow_go green g green_arrow",
        Signal.CAUTION: "caution arrow_caution flashing_caution yellow amber orange y",
        Signal.STOP: "stop arrow_stop flashing_stop red r red_yellow red_amber u",
    }
)

NOT_FOR_CARS = "not_for_cars"
LANE_WORDS: dict[str, str | None] = _table(
    {
        "freeway": "freeway lane_freeway interstate highway main_carriage_way motorway entry exit on_ramp off_ramp "
        "access_ramp exit_ramp connecting_ramp",
        "surface_street": "surface_street lane_surface_street lane_surface_unstructure vehicle lane lane_connector "
        "intersection urban country driving bidirectional drive_way driveway road passenger car hov taxi "
        "roundabout slip_lane shared",
        "bike_lane": "bike_lane lane_bike_lane bike bicycle bicycle_lane biking cycleway",
        "bus_lane": "bus_lane lane_bus_lane bus",
        "undefined": "undefined",
        NOT_FOR_CARS: "sidewalk walkway footway pedestrian crosswalk walking shoulder border median restricted parking "
        "stop none tram rail curb road_works special1 special2 special3",
        None: "unknown lane_unknown",
    }
)


def canonical(word: str) -> str:
    """A word in lower case with underscores, without the prefix of an enum: ``TRAFFIC_LIGHT_RED`` is ``red``."""
    snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", word.strip())
    text = re.sub(r"[\s\-]+", "_", snake).lower()
    prefix = next((prefix for prefix in _PREFIXES if text.startswith(prefix)), "")
    return text[len(prefix) :]


def look_up(table: Mapping[str, V], word: str, default: V, field: str, unknown: Counter[str]) -> V:
    """The meaning of ``word``; ``default`` for a word that the table lacks, which is counted as "field: word"."""
    value = table.get(word.lower().strip(), table.get(canonical(word), _MISSING))
    if value is _MISSING:
        unknown[f"{field}: {word[:60]}"] += 1
        return default
    return value  # pyright: ignore[reportReturnType]


_MISSING = object()
