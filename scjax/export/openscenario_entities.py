"""Objects as OpenSCENARIO entities."""

from __future__ import annotations

from scjax.export.xml_text import XmlElement, add_element, plain_decimal
from scjax.scene import AgentType, Log

_MASSES = {AgentType.VEHICLE: 1500, AgentType.PEDESTRIAN: 75, AgentType.CYCLIST: 90}  # kg; the format asks for one
_WHEELBASE = 0.6  # of the length
_MAX_SPEED, _MAX_ACCELERATION, _MAX_STEERING = 70, 10, 0.6  # m/s, m/s², rad; the format asks for them


def entity_name(log: Log, row: int) -> str:
    """Name of an object: "Ego", or "object" and its id."""
    return "Ego" if row == log.ego_index else f"object {log.object_ids[row]}"


def add_entity(entities: XmlElement, log: Log, row: int) -> None:
    """An object; its reference point is the middle of its box on the ground."""
    kind, name = int(log.object_types[row]), entity_name(log, row)
    entity = add_element(entities, "ScenarioObject", name=name)
    if kind in (AgentType.VEHICLE, AgentType.CYCLIST):
        category = "car" if kind == AgentType.VEHICLE else "bicycle"
        item = add_element(entity, "Vehicle", name=name, vehicleCategory=category, mass=_MASSES[AgentType(kind)])
        _add_box(item, log, row)
        add_element(
            item,
            "Performance",
            maxSpeed=_MAX_SPEED,
            maxAcceleration=_MAX_ACCELERATION,
            maxDeceleration=_MAX_ACCELERATION,
        )
        _add_axles(item, log, row)
    elif kind == AgentType.PEDESTRIAN:
        item = add_element(
            entity,
            "Pedestrian",
            name=name,
            pedestrianCategory="pedestrian",
            mass=_MASSES[AgentType.PEDESTRIAN],
            model3d="",
        )
        _add_box(item, log, row)
    else:
        category = "obstacle" if kind == AgentType.STATIC else "none"
        item = add_element(entity, "MiscObject", name=name, miscObjectCategory=category, mass=10)
        _add_box(item, log, row)
    add_element(item, "Properties")


def _add_box(item: XmlElement, log: Log, row: int) -> None:
    length, width, height = log.sizes[row].tolist()
    box = add_element(item, "BoundingBox")
    add_element(box, "Center", x=0, y=0, z=plain_decimal(height / 2))
    add_element(
        box, "Dimensions", width=plain_decimal(width), length=plain_decimal(length), height=plain_decimal(height)
    )


def _add_axles(item: XmlElement, log: Log, row: int) -> None:
    length, width, _ = log.sizes[row].tolist()
    axles = add_element(item, "Axles")
    for tag, sign, steering in (("FrontAxle", 1, _MAX_STEERING), ("RearAxle", -1, 0)):
        add_element(
            axles,
            tag,
            maxSteering=steering,
            wheelDiameter="0.6",
            trackWidth=plain_decimal(0.8 * width),
            positionX=plain_decimal(sign * _WHEELBASE * length / 2),
            positionZ="0.3",
        )
