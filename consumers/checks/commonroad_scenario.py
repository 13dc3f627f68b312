"""Reads CommonRoad files, writes and reads them again, and checks for collisions and roads: one JSON line for each.

python consumers/checks/commonroad_scenario.py FILE.xml ...
"""

from __future__ import annotations

import json
import logging
import sys
import tempfile
import warnings
from pathlib import Path


def main(files: list[str]) -> None:
    logging.disable(logging.WARNING)
    warnings.simplefilter("ignore")
    for file in files:
        row = {"file": file, "consumer": "commonroad", "ok": False}
        try:
            row |= check(file)
        except Exception as error:  # a judge's errors are results
            row["error"] = f"{type(error).__name__}: {error}"[:400]
        print("RESULT " + json.dumps(row), flush=True)


def check(file: str) -> dict:
    """Sizes of the scenario before and after a round trip, and what the drivability checker makes of it."""
    from commonroad.common.file_reader import CommonRoadFileReader
    from commonroad.common.file_writer import CommonRoadFileWriter, OverwriteExistingFile
    from commonroad.common.util import FileFormat
    from commonroad_dc.boundary.boundary import create_road_boundary_obstacle
    from commonroad_dc.collision.collision_detection.pycrcc_collision_dispatch import create_collision_checker

    scenario, problems = CommonRoadFileReader(file, file_format=FileFormat.XML).open()
    with tempfile.TemporaryDirectory() as folder:
        again = str(Path(folder, "again.xml"))
        writer = CommonRoadFileWriter(
            scenario,
            problems,
            "scjax",
            "",
            "",
            set(),
            file_format=FileFormat.XML,
        )
        writer.write_to_file(again, OverwriteExistingFile.ALWAYS)
        second, _ = CommonRoadFileReader(again, file_format=FileFormat.XML).open()
    checker = create_collision_checker(scenario)
    _, boundary = create_road_boundary_obstacle(scenario)
    expected = len(scenario.dynamic_obstacles) + 1  # all static ones are one group
    faults = _schema_faults(file)
    sizes = [_sizes(scenario), _sizes(second)]
    is_same = sizes[0] == sizes[1] and checker.number_of_obstacles() == expected
    return {
        "ok": is_same and not faults and boundary is not None,
        "lanelets": sizes[0][0],
        "obstacles": sizes[0][1],
        "lights": sizes[0][2],
        "problems": len(problems.planning_problem_dict),
        "links": sizes[0][3],
        "schema": faults,
    }


_LOOSE = ("'maxInclusive'", "Expected is one of ( dynamicObstacle, phantomObstacle")
"""Rules that scenarios of the project itself break: all obstacles begin at step 0, each has a planning problem."""


def _schema_faults(file: str) -> list[str]:
    """What the schema that comes with commonroad-io says."""
    import commonroad.scenario_definition
    from lxml import etree

    folder = Path(commonroad.scenario_definition.__file__).parent / "xml_definition_files"
    schema = etree.XMLSchema(etree.parse(str(folder / "XML_commonRoad_XSD.xsd")))
    schema.validate(etree.parse(file))
    errors = [error for error in schema.error_log if not any(word in error.message for word in _LOOSE)]
    return [f"line {error.line}: {error.message[:160]}" for error in errors[:3]]


def _sizes(scenario) -> tuple[int, int, int, int]:
    network = scenario.lanelet_network
    links = sum(len(lanelet.successor) + len(lanelet.predecessor) for lanelet in network.lanelets)
    return len(network.lanelets), len(scenario.obstacles), len(network.traffic_lights), links


if __name__ == "__main__":
    main(sys.argv[1:])
