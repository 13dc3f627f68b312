"""CommonRoad scenarios (XML, version 2020a): lanelets, traffic lights, obstacles, and the ego's planning problem."""

from __future__ import annotations

import datetime
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from scjax.export.base import Export, Losses
from scjax.export.commonroad_lights import add_lights
from scjax.export.commonroad_obstacles import add_obstacles, add_planning_problem
from scjax.export.roads.lane_network import LaneNetwork, border_line, lane_network
from scjax.export.roads.lane_nodes import lane_nodes, meeting_lines
from scjax.export.traffic import LANE_WIDTH, even_steps, filled_traffic
from scjax.export.xml_text import XmlElement, add_element, add_point, write_xml
from scjax.scene import NO_EGO, Log

_VERSION = "2020a"
_TYPES = {
    "freeway": "highway",
    "bike_lane": "bicycleLane",
    "bus_lane": "busLane",
    "not_for_cars": "sidewalk",
    "undefined": "border",
}
_USERS = {"bike_lane": "bicycle", "not_for_cars": "pedestrian", "bus_lane": "bus", "undefined": "pedestrian"}
_BESIDE_SHARE = 0.8  # of both lanes along which they run side by side


def write_commonroad(log: Log, path: Path, losses: Losses) -> tuple[Path, ...]:
    """Writes ``log`` as a scenario.

    The ego is the planning problem and no obstacle. A log without an ego has no planning problem.

    Raises:
      ValueError: the log has no lane.
    """
    losses["heights of lanes, left out"] += sum(not np.isnan(lane.points).any() for lane in log.lanes)
    losses["heights of objects, left out"] += log.num_objects
    log = even_steps(filled_traffic(log, losses), losses)
    network = lane_network(log, Losses())
    losses["lanes of no length, left out"] += len(log.lanes) - len(network.lanes)
    write_xml(_scenario(log, network, losses), path)
    return (path,)


def _scenario(log: Log, network: LaneNetwork, losses: Losses) -> XmlElement:
    root = ElementTree.Element(
        "commonRoad",
        timeStepSize=f"{log.dt if log.num_steps > 1 else 0.1:.10g}",
        commonRoadVersion=_VERSION,
        author="scjax",
        affiliation="",
        source=log.metadata.domain,
        benchmarkID=_benchmark_id(log),
        date=datetime.date.today().isoformat(),
    )
    location = add_element(root, "location")
    for tag, text in (("geoNameId", "-999"), ("gpsLatitude", "999"), ("gpsLongitude", "999")):
        add_element(location, tag, text)
    add_element(add_element(root, "scenarioTags"), "simulated")
    lanelets = _add_lanelets(root, network, losses)
    number = add_lights(root, lanelets, log, network, len(lanelets) + 1, losses)
    number = add_obstacles(root, log, number, losses)
    if log.ego_index != NO_EGO:
        losses["states of the ego, which is the planning problem"] += int(log.valid[log.ego_index].sum())
        add_planning_problem(root, log, number)
    return root


def _benchmark_id(log: Log) -> str:
    """COUNTRY_Map-1_1_T-1, with the name of the log as the map; ZAM is the country of no place."""
    name = re.sub(r"[^A-Za-z0-9]", "", log.metadata.scene_id)[:40] or "Scene"
    return f"ZAM_{name[0].upper()}{name[1:]}-1_1_T-1"


def _add_lanelets(root: XmlElement, network: LaneNetwork, losses: Losses) -> list[XmlElement]:
    """A lanelet for every lane; ids are indices of lanes plus 1."""
    nodes = lane_nodes(network, losses)
    lines, headings = meeting_lines(network, nodes)
    pairs = [pair for node in nodes for pair in node.pairs]
    left, right = _adjacent(network, losses)
    losses['lanes of type "undefined", written as not for cars'] += sum(
        lane.lane_type == "undefined" for lane in network.lanes
    )
    elements = []
    for row, lane in enumerate(network.lanes):
        element = add_element(root, "lanelet", id=row + 1)
        ends = (float(headings[row, 0]), float(headings[row, 1]))
        for tag, side in (("leftBound", 1), ("rightBound", -1)):
            bound = add_element(element, tag)
            for x, y, _ in border_line(lines[row], side * LANE_WIDTH / 2, ends).tolist():
                add_point(bound, x, y)
        for i in sorted({i for i, j in pairs if j == row}):
            add_element(element, "predecessor", ref=i + 1)
        for j in sorted({j for i, j in pairs if i == row}):
            add_element(element, "successor", ref=j + 1)
        for tag, beside in (("adjacentLeft", left), ("adjacentRight", right)):
            if row in beside:
                add_element(element, tag, ref=beside[row] + 1, drivingDir="same")
        add_element(element, "laneletType", _TYPES.get(lane.lane_type or "", "urban"))
        add_element(element, "userOneWay", _USERS.get(lane.lane_type or "", "vehicle"))
        elements.append(element)
    return elements


def _adjacent(network: LaneNetwork, losses: Losses) -> tuple[dict[int, int], dict[int, int]]:
    """The lane on the left and on the right of lanes, where both run side by side along nearly all of them.

    A lanelet has one lanelet on each side.
    """
    lengths = [float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum()) for line in network.lines]
    rows = []
    for i, besides in enumerate(network.right):
        for beside in besides:
            shares = [(span[1] - span[0]) / lengths[k] for k, span in ((i, beside.own), (beside.lane, beside.other))]
            rows.append((min(shares), i, beside.lane))
    left: dict[int, int] = {}
    right: dict[int, int] = {}
    for share, i, j in sorted(rows, reverse=True):
        if share >= _BESIDE_SHARE and i not in right and j not in left:
            right[i], left[j] = j, i
        else:
            losses["pairs of lanes side by side along a part only, left out"] += 1
    return left, right


COMMONROAD_EXPORT = Export("CommonRoad", ".xml", "CommonRoad tools", write_commonroad)
