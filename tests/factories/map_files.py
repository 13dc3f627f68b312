"""Small files of the formats of others: CommonRoad, Lanelet2, ScenarioNet and Argoverse 2."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from tests.factories.opendrive_files import road, write_map


def lanelet(name: str, x: tuple[float, float], y: float = 0.0, more: str = "", backward: bool = False) -> str:
    """A straight lanelet of CommonRoad along x, 4 m wide; ``backward`` goes to -x."""
    ends = x[::-1] if backward else x
    sides = (-2.0, 2.0) if backward else (2.0, -2.0)
    bounds = "".join(
        f"<{tag}>{''.join(f'<point><x>{at}</x><y>{y + side}</y></point>' for at in ends)}</{tag}>"
        for tag, side in zip(("leftBound", "rightBound"), sides, strict=True)
    )
    return f'<lanelet id="{name}">{bounds}{more}</lanelet>'


LIGHT = """<trafficLight id="9"><cycle><cycleElement><duration>2</duration><color>red</color></cycleElement>
<cycleElement><duration>1</duration><color>green</color></cycleElement><timeOffset>1</timeOffset></cycle></trafficLight>"""


def obstacle(name: str, steps: int = 3, kind: str = "car", speed: float = 10.0) -> str:
    """A dynamic obstacle of CommonRoad that drives along x from 1 on."""
    states = [
        f"<position><point><x>{1 + step}</x><y>0</y></point></position><orientation><exact>0</exact></orientation>"
        f"<time><exact>{step}</exact></time><velocity><exact>{speed}</exact></velocity>"
        for step in range(steps)
    ]
    trajectory = "".join(f"<state>{state}</state>" for state in states[1:])
    shape = "<shape><rectangle><length>4.5</length><width>2</width></rectangle></shape>"
    return (
        f'<dynamicObstacle id="{name}"><type>{kind}</type>{shape}<initialState>{states[0]}</initialState>'
        f"<trajectory>{trajectory}</trajectory></dynamicObstacle>"
    )


def commonroad(*elements: str) -> str:
    """A CommonRoad file of version 2020a."""
    head = '<commonRoad commonRoadVersion="2020a" benchmarkID="DEU_Test-1_2_T-3" timeStepSize="0.2">'
    return f"<?xml version='1.0' encoding='UTF-8'?>{head}{''.join(elements)}</commonRoad>"


def crossing() -> str:
    """A CommonRoad file: ``1`` forks into ``2`` and, beside it, ``3``; a light, a car and a planning problem."""
    ahead = '<successor ref="2"/><successor ref="3"/><laneletType>urban</laneletType><trafficLightRef ref="9"/>'
    return commonroad(
        lanelet("1", (0, 50), more=ahead),
        lanelet("2", (50, 90), more='<predecessor ref="1"/><adjacentLeft ref="4" drivingDir="opposite"/>'),
        lanelet("3", (50, 70), more='<predecessor ref="1"/><adjacentRight ref="2" drivingDir="same"/>'),
        lanelet("4", (50, 90), 4.0, "<laneletType>sidewalk</laneletType>", backward=True),
        LIGHT,
        '<intersection id="7"><incoming id="8"><incomingLanelet ref="1"/><successorsStraight ref="2"/></incoming>'
        "</intersection>",
        obstacle("20"),
        '<planningProblem id="30"/>',
    )


def lanelet2(in_degrees: bool = False, one_way: str = "yes") -> str:
    """A Lanelet2 map: lanelets 11 and 12 in line, 13 beside 11, a sidewalk 14, and a light behind 11.

    In meters unless ``in_degrees``; the right bound of 11 is stored against its direction.
    """
    places = {
        "1": (0, 3),
        "2": (20, 3),
        "3": (40, 3),
        "4": (0, 0),
        "5": (20, 0),
        "6": (40, 0),
        "7": (0, -3),
        "8": (20, -3),
    }
    nodes = []
    for name, (x, y) in places.items():
        if in_degrees:
            nodes.append(f'<node id="{name}" lat="{49 + y / 111_213:.9f}" lon="{8.4 + x / 73_171:.9f}"/>')
        else:
            tags = f'<tag k="local_x" v="{x}"/><tag k="local_y" v="{y}"/><tag k="ele" v="5"/>'
            nodes.append(f'<node id="{name}" lat="" lon="">{tags}</node>')
    ways = {"21": "12", "22": "23", "23": "54", "24": "56", "25": "78"}
    lines = [
        f'<way id="{name}">{"".join(f"<nd ref={chr(34)}{n}{chr(34)}/>" for n in line)}</way>'
        for name, line in ways.items()
    ]
    lanelets = {
        "11": ("21", "23", "road"),
        "12": ("22", "24", "road"),
        "13": ("23", "25", "road"),
        "14": ("21", "25", "walkway"),
    }
    relations = [
        f'<relation id="{name}"><member type="way" role="left" ref="{left}"/><member type="way" role="right" '
        f'ref="{right}"/>{RULE if name == "11" else ""}<tag k="type" v="lanelet"/><tag k="subtype" v="{word}"/>'
        f'<tag k="one_way" v="{one_way}"/></relation>'
        for name, (left, right, word) in lanelets.items()
    ]
    light = '<relation id="31"><tag k="type" v="regulatory_element"/><tag k="subtype" v="traffic_light"/></relation>'
    return f"<osm version='0.6'>{''.join(nodes)}{''.join(lines)}{''.join(relations)}{light}</osm>"


RULE = '<member type="relation" role="regulatory_element" ref="31"/>'


def scenarionet(steps: int = 4, **changes: Any) -> dict[str, Any]:
    """A scenario of ScenarioNet: a car and a cone on a lane with a light, and a crosswalk."""

    def track(kind: str, x: float, valid: list[bool]) -> dict[str, Any]:
        state = {
            "position": np.stack([x + np.arange(steps), np.zeros(steps), np.full(steps, 0.8)], -1),
            "heading": np.zeros(steps),
            "velocity": np.tile([10.0, 0.0], (steps, 1)),
            "valid": np.array(valid),
            **{key: np.full((steps, 1), size) for key, size in (("length", 4.5), ("width", 2.0), ("height", 1.6))},
        }
        return {"type": kind, "state": state, "metadata": {}}

    line = np.stack([np.arange(0.0, 60.0, 5.0), np.zeros(12), np.zeros(12)], -1)
    content = {
        "id": "scene-1",
        "version": "test",
        "length": steps,
        "metadata": {"ts": 0.1 * np.arange(steps), "dataset": "waymo", "sdc_id": "7", "coordinate": "right-handed"},
        "tracks": {
            "7": track("VEHICLE", 1.0, [True] * steps),
            "8": track("TRAFFIC_CONE", 9.0, [False] + [True] * (steps - 1)),
        },
        "map_features": {
            "a": {"type": "LANE_SURFACE_STREET", "polyline": line, "exit_lanes": ["b"], "left_neighbor": []},
            "b": {"type": "LANE_SURFACE_STREET", "polyline": line + np.array([55.0, 0, 0]), "entry_lanes": ["a"]},
            "c": {"type": "CROSSWALK", "polygon": line[:3]},
        },
        "dynamic_map_states": {
            "b": {
                "type": "TRAFFIC_LIGHT",
                "lane": "b",
                "stop_point": np.array([55.0, 0.0, 0.0]),
                "state": {"object_state": ["TRAFFIC_LIGHT_RED"] * (steps - 1) + ["TRAFFIC_LIGHT_GREEN"]},
            }
        },
    }
    return content | changes


def av2_map(**changes: Any) -> dict[str, Any]:
    """A map archive of Argoverse 2: lane 1 leads into lane 2; lane 3 is a bike lane beside lane 1."""

    def segment(name: int, x: tuple[float, float], y: float, kind: str = "VEHICLE", **more: Any) -> dict[str, Any]:
        bounds = {
            f"{side}_lane_boundary": [{"x": at, "y": y + across, "z": 1.0} for at in x]
            for side, across in (("left", 1.75), ("right", -1.75))
        }
        relations = {"predecessors": [], "successors": [], "left_neighbor_id": None, "right_neighbor_id": None}
        return {"id": name, "is_intersection": False, "lane_type": kind, **bounds, **relations, **more}

    segments = [
        segment(1, (0, 30), 0, successors=[2], right_neighbor_id=3),
        segment(2, (30, 60), 0, predecessors=[1], left_neighbor_id=99),
        segment(3, (0, 30), -3.5, "BIKE"),
    ]
    content = {
        "drivable_areas": {},
        "lane_segments": {str(item["id"]): item for item in segments},
        "pedestrian_crossings": {},
    }
    return content | changes


def write_map_files(folder: Path) -> dict[str, Path]:
    """One valid file of every format: format -> path."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        "CommonRoad": ("scenario.xml", crossing()),
        "Lanelet2": ("town.osm", lanelet2()),
        "Argoverse 2 map": ("log_map_archive_abc____PIT_city_1.json", json.dumps(av2_map())),
    }
    paths = {name: folder / file for name, (file, _) in texts.items()}
    for name, (_, text) in texts.items():
        paths[name].write_text(text)
    paths["ScenarioNet"] = folder / "sd_scene-1.pkl"
    paths["ScenarioNet"].write_bytes(pickle.dumps(scenarionet()))
    paths["OpenDRIVE"] = write_map(folder, road("1"), name="town.xodr")
    return paths
