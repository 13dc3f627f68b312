"""Scenes drawn by hand that each show one rare event, and similar scenes without it."""

from __future__ import annotations

from scjax.scene import AgentType
from tests.factories.hand_drawn_scene import WIDTH, SceneBuilder


def two_way_road(**options) -> SceneBuilder:
    builder = SceneBuilder()
    builder.add_road(**{"same": 2, "opposite": 2, **options})
    return builder


def emergency_corridor(lateral: float) -> SceneBuilder:
    builder = SceneBuilder(speed=0.5)
    builder.add_road(same=2, opposite=0)
    for x in (-14, 8, 16):
        builder.add_agent(x, lateral, 0, 0.3)
        builder.add_agent(x, -WIDTH - lateral, 0, 0.3)
    return builder


def cones(*places: tuple[float, float]) -> SceneBuilder:
    builder = two_way_road()
    for x, y in places:
        builder.add_agent(x, y, 0, 0.0, AgentType.STATIC)
    return builder


EVENT_SCENES = {
    "wrong-way": (
        two_way_road().add_agent(15, 0, 180, 9.0),
        [
            two_way_road().add_agent(15, WIDTH, 180, 9.0),
            two_way_road().add_agent(15, 0, 0, 9.0),
            two_way_road().add_agent(15, 0, 180, 0.0),
        ],
    ),
    "jaywalker": (
        two_way_road().add_agent(14, 0.5, 90, 1.4, AgentType.PEDESTRIAN),
        [
            two_way_road().add_agent(14, -9.0, 90, 1.4, AgentType.PEDESTRIAN),
            SceneBuilder()
            .add_intersection((20, 1.75), (0, 90, 180, 270))
            .add_agent(8.5, 0, 90, 1.4, AgentType.PEDESTRIAN),
        ],
    ),
    "stopped-in-lane": (
        two_way_road().add_agent(12, 0, 0, 0.0),
        [
            two_way_road().add_agent(12, 0, 0, 0.0).add_agent(19, 0, 0, 0.0),
            two_way_road().add_agent(12, -WIDTH - 2.6, 0, 0.0),
            two_way_road().add_agent(12, 0, 0, 3.0),
            SceneBuilder().add_intersection((20, 1.75), (0, 90, 180, 270)).add_agent(7, 0, 0, 0.0),
        ],
    ),
    "double-parking": (
        two_way_road().add_agent(12, -WIDTH - 0.8, 0, 0.0).add_agent(12.5, -WIDTH - 3.2, 0, 0.0),
        [two_way_road().add_agent(12, -WIDTH - 3.2, 0, 0.0).add_agent(18, -WIDTH - 3.2, 0, 0.0)],
    ),
    "emergency-corridor": (emergency_corridor(0.8), [emergency_corridor(0.0), emergency_corridor(-0.5)]),
    "cut-in": (
        two_way_road().add_agent(10, -2.0, 6, 8.0),
        [
            two_way_road().add_agent(10, -WIDTH, 0, 8.0),
            two_way_road().add_agent(10, -2.0, 0, 8.0),
            two_way_road().add_agent(-12, -2.0, 6, 8.0),
        ],
    ),
    "work-zone": (
        cones((10, -5.0), (13, -4.2), (16, -3.4), (19, -2.6)),
        [cones((10, -5.0), (13, -5.0)), cones((10, -20.0), (13, -20.0), (16, -20.0))],
    ),
}
