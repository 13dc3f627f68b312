"""Reader of Lanelet2 maps in .osm files: lanelets in degrees or in meters, and the lights that control them.

Read are bounds, center lines, subtypes, participants and traffic lights. Areas, right of way, speed limits and signs
are not; lane changes follow from shared bounds, whatever their marking.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from scjax.data.readers.base import FileFormat, naming_file, read_file_bytes
from scjax.data.readers.lanelet2.lanelet_lanes import Lanelet, lanelet_lanes, read_lanelet_relations
from scjax.data.readers.lanelet2.osm import Osm, read_osm
from scjax.data.readers.vocabulary import NOT_FOR_CARS
from scjax.data.readers.xml_elements import has_root, parse_elements
from scjax.scene import Log, LogMetadata, Map, MapLane, Signal, map_to_log, validate_log

LANELET2_DOMAIN = "lanelet2"


def read_lanelet2(path: str | Path, location: str = "") -> Log:
    """The map in a Lanelet2 file (.osm): a log of one step without objects, lights of unknown state.

    x points east and y north, in meters from the middle of the map; the metadata's ``variant`` says where that is.
    Maps with ``local_x`` and ``local_y`` keep these.

    Args:
      location: ``LogMetadata.location_cluster``; the name of the file by default.

    Raises:
      ValueError: naming the file, the element with its line, what is wrong with it and what to do.
    """
    path = Path(path)
    data = read_file_bytes(path)
    with naming_file(path):
        root = parse_elements(data, frozenset())
        if root.tag != "osm":
            raise ValueError(f"line {root.line}: the root is <{root.tag[:40]}>, not <osm>: give a Lanelet2 file")
        unknown: Counter[str] = Counter()
        notes: Counter[str] = Counter()
        osm = read_osm(root)
        lanelets = read_lanelet_relations(osm)
        lanes = lanelet_lanes(lanelets, unknown, notes)
        if all(lane.lane_type == NOT_FOR_CARS for lane in lanes.values()):
            raise ValueError("it has no lanelet that cars may use: leave this file out")
        lights = _stop_points(osm, lanelets, lanes, notes)
        place = "in meters" if osm.origin is None else f"at {osm.origin[0]:.4f}, {osm.origin[1]:.4f}"
        metadata = LogMetadata(
            domain=LANELET2_DOMAIN,
            scene_id=location or path.stem,
            location_cluster=location or path.stem,
            variant=f"lanelet2 {place}",
            source_file=str(path),
            source_sha256=hashlib.sha256(data).hexdigest(),
            unknown_words=dict(sorted(unknown.items())),
            notes=dict(sorted(notes.items())),
        )
        map = Map(
            lanes=tuple(lanes.values()),
            signal_lane_ids=tuple(lights),
            signal_states=np.full(len(lights), Signal.UNKNOWN, np.int8),
            signal_positions=np.array(list(lights.values()), np.float64).reshape(-1, 3),
            metadata=metadata,
        )
        return validate_log(map_to_log(map))


def _stop_points(
    osm: Osm, lanelets: Mapping[str, Lanelet], lanes: Mapping[str, MapLane], notes: Counter[str]
) -> dict[str, list[float]]:
    """Lane -> stop point [m], of all lanes that a traffic light controls.

    A lanelet refers to the light at its end: the light controls what follows. Of a lanelet that is itself a turn
    (tag ``turn_direction``), or that nothing follows, the light controls the lanelet.
    """
    rules = {name: osm.tags["relation", name].get("subtype", "") for name in osm.relations}
    points: dict[str, list[float]] = {}
    for name, lanelet in lanelets.items():
        for rule in lanelet.rules:
            if rules.get(rule) != "traffic_light":
                notes[f"rules {rules.get(rule) or 'that are missing'}, not read"] += 1
            elif lanes[name].lane_type != NOT_FOR_CARS:
                is_turn = "turn_direction" in lanelet.tags
                for lane in [name] if is_turn else lanes[name].successors or (name,):
                    points[lane] = lanelet.center[0 if is_turn else -1].tolist()
    return points


def _is_osm(head: bytes) -> bool:
    return has_root(head, b"osm")


LANELET2 = FileFormat("Lanelet2", "*.osm", LANELET2_DOMAIN, _is_osm, read_lanelet2)
