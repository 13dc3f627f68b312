"""The table of attributes: what requests it takes, what scenes show, and the page that follows from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scjax.language.analysis.crossroads import Crossroad
from scjax.language.analysis.layouts import layout_names
from scjax.language.attributes.base import UNSPECIFIED
from scjax.language.attributes.page import attributes_page
from scjax.language.attributes.table import (
    ATTRIBUTES,
    check_attributes,
    measure_attributes,
    score_attributes,
)
from scjax.scene import AgentType, Signal, empty
from tests.factories.event_scenes import emergency_corridor
from tests.factories.hand_drawn_scene import WIDTH, SceneBuilder
from tests.factories.road_scenes import (
    bridge,
    curved_road,
    fork,
    intersection,
    intersection_with_signal,
    roundabout,
    straight_road,
    turn_lane,
    winding_road,
)
from tests.factories.traffic import agent, lane, scene

ROOT = Path(__file__).resolve().parents[2]


def with_agents(builder, *agents):
    for x, y, heading, speed, *agent_type in agents:
        builder.add_agent(x, y, heading, speed, *agent_type)
    return builder


def rising_road(rise):
    builder = SceneBuilder()
    builder.add_lane((-32, 0), (32, 0))
    scene = builder.scene()
    lanes = np.array(scene.lanes)
    lanes[..., 2] = lanes[..., 0] / 30 * rise
    return scene.replace(lanes=lanes)


def at_speed(speed):
    builder = SceneBuilder(speed=speed)
    builder.add_road(1, 1)
    return builder.scene()


SHOWS = {
    "straight": (straight_road(2, 1).scene, {"layout": "straight", "lanes_same": 2, "lanes_total": 3, "median": False}),
    "one way": (straight_road(2, 0).scene, {"one_way": True, "lanes_opposite": 0, "ego_lane": "leftmost"}),
    "median": (straight_road(1, 1, gap=5.0).scene, {"median": True, "one_way": False}),
    "curve": (curved_road(50).scene, {"layout": "curve", "bend": "left", "not_layout": "straight"}),
    "winding": (winding_road().scene, {"layout": "winding"}),
    "four-way": (intersection(15, 0, (0, 90, 180, -90)).scene, {"layout": "four-way", "not_layout": "T"}),
    "T, through": (intersection(12, 0, (0, 180, -90)).scene, {"layout": "T", "ego_arm": "through"}),
    "T, stem": (intersection(12, 0, (90, 180, -90)).scene, {"layout": "T", "ego_arm": "stem"}),
    "Y": (intersection(12, 0, (180, 60, -60)).scene, {"layout": "Y"}),
    "roundabout": (roundabout().scene, {"layout": "roundabout"}),
    "split": (fork(0.3).scene, {"layout": "split"}),
    "merge": (fork(0.3, merge=True).scene, {"layout": "merge"}),
    "overpass": (bridge().scene, {"layout": "crossing-overpass"}),
    "turn lane": (turn_lane("left").scene, {"turn_lane": ["left"], "ego_manoeuvre": "left"}),
    "red light": (intersection_with_signal(Signal.STOP).scene, {"signal": "red"}),
    "no light": (straight_road().scene, {"signal": "none"}),
    "up": (lambda: rising_road(2.0), {"slope": "up"}),
    "down": (lambda: rising_road(-2.0), {"slope": "down"}),
    "flat": (lambda: rising_road(0.3), {"slope": "flat"}),
    "ego stands": (lambda: at_speed(0.0), {"ego": "stopped"}),
    "ego crawls": (lambda: at_speed(3.0), {"ego": "slow"}),
    "ego moves slowly": (lambda: at_speed(3.0), {"ego": "moving"}),
    "ego is fast": (lambda: at_speed(15.0), {"ego": "fast"}),
    "leader": (
        with_agents(straight_road(2, 1), (15, 0, 0, 5), (-12, 0, 0, 5), (6, -WIDTH, 0, 5), (9, WIDTH, 180, 5)).scene,
        {"vehicles": 4, "ahead": 1, "behind": 1, "gap_ahead": (10, 11), "left_lane": 0, "right_lane": 1, "oncoming": 1},
    ),
    "queue": (
        with_agents(straight_road(1, 1), (8, 0, 0, 0), (15, 0, 0, 0), (22, 0, 0, 1)).scene,
        {"queue": True, "stopped": 2, "ahead": 3},
    ),
    "parked": (with_agents(straight_road(1, 1), (8, -3, 0, 0)).scene, {"parked": 1, "stopped": 1, "queue": False}),
    "across": (
        with_agents(intersection(15, 0, (0, 90, 180, -90)), (16.75, 9, 90, 5)).scene,
        {"crossing": 1, "oncoming": 0},
    ),
    "people": (
        with_agents(
            straight_road(),
            (20, 0.5, 90, 1, AgentType.PEDESTRIAN),
            (-5, -4, 0, 1, AgentType.PEDESTRIAN),
            (9, -3, 0, 4, AgentType.CYCLIST),
        ).scene,
        {
            **{"pedestrians": 2, "cyclists": 1, "pedestrians_on_road": 1, "pedestrians_ahead": 1, "event": "jaywalker"},
            "where": ["cyclists right", "pedestrians behind"],
            "compare": "pedestrians > cyclists",
        },
    ),
    "wrong way": (with_agents(straight_road(2, 0), (14, -WIDTH, 180, 9)).scene, {"event": "wrong-way"}),
    "stopped": (with_agents(straight_road(1, 1), (8, 0, 0, 0)).scene, {"event": "stopped-in-lane"}),
    "double-parking": (
        with_agents(straight_road(1, 1), (8, -0.8, 0, 0), (8, -3.2, 0, 0)).scene,
        {"event": "double-parking"},
    ),
    "corridor": (emergency_corridor(0.7).scene, {"event": "emergency-corridor"}),
    "cut-in": (
        with_agents(straight_road(2, 0), (14, -WIDTH + 1.4, -8, 9), (2, -WIDTH, 0, 9)).scene,
        {"event": "cut-in"},
    ),
    "cones": (
        with_agents(straight_road(), *((x, -2, 0, 0, AgentType.STATIC) for x in (8, 10, 12))).scene,
        {"event": "work-zone", "static": 3},
    ),
}


@pytest.mark.parametrize("name", SHOWS)
def test_scene_shows_what_was_drawn(name):
    scene, request = SHOWS[name]
    assert score_attributes(scene(), request).misses == {}


def test_measurements_cover_the_table_and_hold_for_themselves():
    measured = measure_attributes(intersection_with_signal(Signal.GO).scene())
    assert list(measured) == list(ATTRIBUTES)
    for name, value in measured.items():
        requests = value if isinstance(value, tuple) else () if value is None else (value,)
        for request in requests:
            assert ATTRIBUTES[name].holds(ATTRIBUTES[name].check(request), value), name


@pytest.mark.parametrize(
    "scene", [empty(0, 0), empty(1, 0), straight_road().scene().replace(agent_mask=np.zeros(1, bool))]
)
def test_scenes_without_lanes_or_agents_are_measured(scene):
    assert measure_attributes(scene)["vehicles"] == 0


def test_score_is_the_share_of_requests_that_hold():
    scene = straight_road(2, 1).scene()
    score = score_attributes(scene, {"layout": "straight", "lanes_same": 3, "vehicles": [0, 2], "queue": True})
    assert score.share == 0.5
    assert score.misses == {"lanes_same": 2, "queue": False}
    assert score_attributes(scene, {"layout": UNSPECIFIED, "vehicles": None}).share == 1.0


def test_open_range_holds_without_a_vehicle_ahead():
    scene = straight_road().scene()
    assert not score_attributes(scene, {"gap_ahead": (10, None)}).misses
    assert score_attributes(scene, {"gap_ahead": (10, 20)}).misses == {"gap_ahead": None}


def test_vehicles_that_cross_the_way_or_park_beside_it_are_not_ahead():
    road = [lane((-32, 0), (32, 0)), lane((20, -32), (20, 32))]
    ahead, across, parked = agent(10, 0, 0, 5), agent(20, 0, 90, 5), agent(28, -1.7, 0, 0)
    measured = measure_attributes(scene([agent(0, 0, 0, 5), ahead, across, parked], road))
    assert (measured["ahead"], measured["crossing"], measured["parked"]) == (1, 1, 1)


def test_of_several_junctions_the_far_ones_do_not_name_the_road():
    def names(*crossroads):
        options = {"has_ring": False, "has_parking": False, "has_overpass": False, "is_dead_end": False}
        return layout_names(list(crossroads), [], "straight", **options)

    def junction(x, *arms):
        return Crossroad(np.array([x, 0.0]), np.zeros((1, 2)), 8.0, tuple(np.deg2rad(arms)))

    tee, cross = junction(5.0, -90, 0, 180), (-90, 0, 90, 180)
    assert names(tee, junction(28.0, *cross)) == ("T", "multi-intersection", "intersection")
    assert "four-way" in names(tee, junction(20.0, *cross))
    assert names(junction(28.0, *cross)) == ("four-way", "intersection")
    assert names(junction(36.0, *cross)) == ("straight", "no-intersection")


@pytest.mark.parametrize(
    ("request_", "normal"),
    [
        ({"vehicles": 3}, {"vehicles": (3, 3)}),
        ({"vehicles": [3, None]}, {"vehicles": (3, None)}),
        ({"vehicles": (None, 3)}, {"vehicles": (0, 3)}),
        ({"event": ["cut-in", "wrong-way"]}, {"event": ("wrong-way", "cut-in")}),
        ({"one_way": np.True_}, {"one_way": True}),
        ({"layout": UNSPECIFIED, "ego": None}, {}),
    ],
)
def test_requests_have_a_normal_form(request_, normal):
    assert check_attributes(request_) == normal
    assert check_attributes(check_attributes(request_)) == normal


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"vehicle": 3}, "no attribute 'vehicle': write 'vehicles'"),
        ({"layout": "four way"}, "layout has no value 'four way': write 'four-way'"),
        ({"layout": 3}, "layout has no value 3: give one of straight"),
        ({"vehicles": "many"}, "vehicles is 'many': give a number"),
        ({"vehicles": True}, "vehicles is True: give a number"),
        ({"vehicles": [1, 2, 3]}, "vehicles is .*: give a number or"),
        ({"vehicles": [5, 3]}, "give the least number first"),
        ({"vehicles": -1}, "give numbers from 0 to 100"),
        ({"vehicles": float("nan")}, "vehicles is nan: give a number"),
        ({"one_way": "yes"}, "one_way is 'yes': give true or false"),
        ({"event": []}, "event is .*: give a list of wrong-way"),
        ({"event": ["crash"]}, "event has no value 'crash'"),
        ("T", "attributes must map names to values, not be a str"),
    ],
)
def test_faulty_requests_are_refused(request_, message):
    with pytest.raises(ValueError, match=message):
        check_attributes(request_)


def test_page_follows_from_the_table():
    page = (ROOT / "docs/attributes.md").read_text(encoding="utf-8")
    assert page == attributes_page(), "run python -m scjax.language.attributes.page docs/attributes.md"
