"""What the formats' own libraries find in files; runs in their environment, without scjax.

python consumers.py FORMAT FILES prints one JSON object: file -> lanes (id -> length [m]), connections (pairs of ids
that follow each other) and seconds; or the error of the library.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any


def read_commonroad(path: str) -> dict[str, Any]:
    """Lanelets by commonroad-io: lengths of their center vertices."""
    from commonroad.common.file_reader import CommonRoadFileReader
    from commonroad.common.util import FileFormat

    scenario, _ = CommonRoadFileReader(path, file_format=FileFormat.XML).open()
    lanelets = scenario.lanelet_network.lanelets
    return {
        "lanes": {str(lanelet.lanelet_id): float(lanelet.distance[-1]) for lanelet in lanelets},
        "connections": [[str(lanelet.lanelet_id), str(other)] for lanelet in lanelets for other in lanelet.successor],
        "lights": len(scenario.lanelet_network.traffic_lights),
        "objects": len(scenario.obstacles),
    }


def read_lanelet2(path: str) -> dict[str, Any]:
    """Lanelets by Lanelet2: lengths of their center lines, and what may follow what for vehicles and pedestrians."""
    import lanelet2
    from lanelet2.projection import UtmProjector

    origin = _first_node(path)
    lanelet_map, errors = lanelet2.io.loadRobust(path, UtmProjector(lanelet2.io.Origin(*origin)))
    rules = lanelet2.traffic_rules
    graph = lanelet2.routing.RoutingGraph(
        lanelet_map, rules.create(rules.Locations.Germany, rules.Participants.Vehicle)
    )
    lanelets = list(lanelet_map.laneletLayer)
    return {
        "lanes": {str(item.id): float(lanelet2.geometry.length2d(item)) for item in lanelets},
        "connections": [[str(item.id), str(other.id)] for item in lanelets for other in graph.following(item)],
        "errors": len(errors),
    }


def _first_node(path: str) -> tuple[float, float]:
    from xml.etree import ElementTree

    for node in ElementTree.parse(path).getroot().iter("node"):
        if node.get("lat"):
            return float(node.get("lat", "")), float(node.get("lon", ""))
    raise ValueError("its nodes have no latitude, which Lanelet2 needs")


READERS: dict[str, Callable[[str], dict[str, Any]]] = {"commonroad": read_commonroad, "lanelet2": read_lanelet2}


def main() -> None:
    warnings.simplefilter("ignore")
    form, *paths = sys.argv[1:]
    results: dict[str, Any] = {}
    for path in paths:
        start = time.process_time()
        try:
            results[path] = READERS[form](path)
        except Exception as error:  # whatever the library raises is a result
            results[path] = {"error": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}
        results[path]["seconds"] = time.process_time() - start
    json.dump(results, sys.stdout)


if __name__ == "__main__":
    main()
