"""OpenSCENARIO 1.2 (ASAM): every object follows its recorded trajectory, on the OpenDRIVE file beside."""

from __future__ import annotations

import itertools
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from scjax.export.base import Export, Losses
from scjax.export.opendrive import OpenDriveRoads, opendrive_tree, road_network
from scjax.export.openscenario_entities import add_entity, entity_name
from scjax.export.traffic import filled_traffic
from scjax.export.xml_text import XmlElement, add_element, plain_decimal, write_xml
from scjax.scene import Log, Signal

_DATE = "2000-01-01T00:00:00"  # the same log gives the same file
_LAMPS = {  # red, yellow, green
    Signal.UNKNOWN: "off;off;off",
    Signal.STOP: "on;off;off",
    Signal.CAUTION: "off;on;off",
    Signal.GO: "off;off;on",
}


def write_openscenario(log: Log, path: Path, losses: Losses) -> tuple[Path, ...]:
    """Writes ``log`` as a scenario, and its map as the .xodr file of the same name.

    Raises:
      ValueError: the log has no lane.
    """
    log = filled_traffic(log, losses)
    network = road_network(log, losses)
    roads = path.with_suffix(".xodr")
    root = ElementTree.Element("OpenSCENARIO")
    name = log.metadata.scene_id or path.stem
    add_element(root, "FileHeader", revMajor=1, revMinor=2, date=_DATE, author="scjax", description=name)
    add_element(root, "CatalogLocations")
    road_element = add_element(root, "RoadNetwork")
    add_element(road_element, "LogicFile", filepath=roads.name)
    _add_signals(road_element, log, network)
    entities = add_element(root, "Entities")
    for row in range(log.num_objects):
        add_entity(entities, log, row)
    _add_storyboard(root, log)
    write_xml(opendrive_tree(network, name), roads)
    write_xml(root, path)
    return (path, roads)


def _add_signals(roads: XmlElement, log: Log, network: OpenDriveRoads) -> None:
    """One controller that steps through the states of all signals; after the log it begins again."""
    signals = [signal for group in network.signals.values() for signal in group]
    if not signals:
        return
    group = add_element(roads, "TrafficSignals")
    controller = add_element(group, "TrafficSignalController", name="signals")
    step = log.dt if log.num_steps > 1 else 1.0
    changes = itertools.groupby(range(log.num_steps), key=lambda k: tuple(log.signal_states[:, k].tolist()))
    for number, (states, steps) in enumerate(changes):
        duration = plain_decimal(len(list(steps)) * step)
        phase = add_element(controller, "Phase", name=f"phase-{number}", duration=duration)
        for signal in signals:
            lamps = _LAMPS[Signal(states[signal.row])]
            add_element(phase, "TrafficSignalState", trafficSignalId=signal.name, state=lamps)


def _add_storyboard(root: XmlElement, log: Log) -> None:
    board = add_element(root, "Storyboard")
    actions = add_element(add_element(board, "Init"), "Actions")
    story = add_element(board, "Story", name="log")
    act = add_element(story, "Act", name="log")
    for row in range(log.num_objects):
        steps = np.flatnonzero(log.valid[row])
        if steps[0] == 0:
            private = add_element(actions, "Private", entityRef=entity_name(log, row))
            teleport = add_element(add_element(private, "PrivateAction"), "TeleportAction")
            _add_position(teleport, log, row, 0)
        _add_maneuvers(act, log, row, steps)
    if not len(act):  # an act has at least one group
        group = add_element(act, "ManeuverGroup", maximumExecutionCount=1, name="nobody")
        add_element(group, "Actors", selectTriggeringEntities="false")
    _add_time_trigger(add_element(act, "StartTrigger"), 0.0)
    _add_time_trigger(add_element(board, "StopTrigger"), float(log.timestamps[-1] - log.timestamps[0]))


def _add_maneuvers(act: XmlElement, log: Log, row: int, steps: np.ndarray) -> None:
    """What an object does: it appears, follows its trajectory, and disappears."""
    name, times = entity_name(log, row), log.timestamps - log.timestamps[0]
    group = add_element(act, "ManeuverGroup", maximumExecutionCount=1, name=name)
    actors = add_element(group, "Actors", selectTriggeringEntities="false")
    add_element(actors, "EntityRef", entityRef=name)
    maneuver = add_element(group, "Maneuver", name=name)
    if steps[0] > 0:
        event = _add_event(maneuver, "appear", float(times[steps[0]]))
        action = add_element(add_element(event, "GlobalAction"), "EntityAction", entityRef=name)
        _add_position(add_element(action, "AddEntityAction"), log, row, int(steps[0]))
    if len(steps) > 1:
        event = _add_event(maneuver, "drive", float(times[steps[0]]))
        routing = add_element(add_element(event, "PrivateAction"), "RoutingAction")
        follow = add_element(routing, "FollowTrajectoryAction")
        reference = add_element(follow, "TrajectoryRef")
        trajectory = add_element(reference, "Trajectory", name=name, closed="false")
        line = add_element(add_element(trajectory, "Shape"), "Polyline")
        for step in steps.tolist():
            vertex = add_element(line, "Vertex", time=plain_decimal(float(times[step])))
            _add_position(vertex, log, row, step)
        timing = add_element(add_element(follow, "TimeReference"), "Timing")
        timing.attrib.update(domainAbsoluteRelative="absolute", scale="1", offset="0")
        add_element(follow, "TrajectoryFollowingMode", followingMode="position")
    if steps[-1] < log.num_steps - 1:
        event = _add_event(maneuver, "disappear", float(times[steps[-1] + 1]))
        action = add_element(add_element(event, "GlobalAction"), "EntityAction", entityRef=name)
        add_element(action, "DeleteEntityAction")
    if not maneuver.findall("Event"):
        act.remove(group)


def _add_event(maneuver: XmlElement, name: str, time: float) -> XmlElement:
    """An event with one action, which is returned."""
    event = add_element(maneuver, "Event", name=f"{maneuver.get('name')} {name}", priority="parallel")
    action = add_element(event, "Action", name=f"{maneuver.get('name')} {name}")
    _add_time_trigger(add_element(event, "StartTrigger"), time)
    return action


def _add_time_trigger(trigger: XmlElement, time: float) -> None:
    condition = add_element(
        add_element(trigger, "ConditionGroup"), "Condition", name="time", delay="0", conditionEdge="none"
    )
    by_value = add_element(condition, "ByValueCondition")
    add_element(by_value, "SimulationTimeCondition", value=plain_decimal(time), rule="greaterOrEqual")


def _add_position(parent: XmlElement, log: Log, row: int, step: int) -> None:
    """The middle of the box on the ground."""
    x, y, z = log.positions[row, step].tolist()
    heading = float(np.angle(np.exp(1j * log.headings[row, step])))
    values = {"x": x, "y": y, "z": z - float(log.sizes[row, 2]) / 2, "h": heading, "p": 0.0, "r": 0.0}
    position = add_element(parent, "Position")
    add_element(position, "WorldPosition", **{name: plain_decimal(value) for name, value in values.items()})


OPENSCENARIO_EXPORT = Export("OpenSCENARIO", ".xosc", "esmini, CARLA", write_openscenario)
