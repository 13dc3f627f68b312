"""Thirty scenes drawn by hand, and what the captioner must see in them."""

import json

import numpy as np
import pytest

from scjax.language.facts import FORMAT, Facts, extract_facts
from scjax.language.intersections import find_intersections, has_roundabout
from scjax.language.road import road_of
from scjax.scene import AgentType, Signal, empty, pad, permute
from tests.factories.towns import WIDTH, Town


def road(same=1, opposite=1, **kwargs):
    town = Town()
    town.road(same, opposite, **kwargs)
    return town


def at(x, y, arms, lanes=1, **kwargs):
    """An intersection whose road towards the west holds the ego in its lane."""
    return Town().crossing((x, y + WIDTH / 2), arms, lanes, **kwargs)


def frayed():
    """A T of which a connector ends askew, as a model may draw it."""
    town = at(12, 0, (0, 180, -90), lanes=2)
    connector = town.lanes[14]
    connector[-2:, :2] = connector[-3, :2] + np.array([[0.9], [1.8]]) * np.array([np.cos(-0.9), np.sin(-0.9)])
    return town


def bend(degrees):
    """An arc of 64 m that turns by twice ``degrees`` / 1.07 within 30 m of the ego either way."""
    town, turn = Town(), np.deg2rad(degrees) * np.linspace(-1, 1, 41) / 2
    radius = 32 / np.deg2rad(degrees) * 2
    for side, flip in ((0.0, 1), (WIDTH, -1)):
        line = np.stack([(radius - side) * np.sin(turn), radius - (radius - side) * np.cos(turn)], -1)
        town.line(*line[::flip])
    return town


def winding():
    town, x = Town(), np.linspace(-32, 32, 60)
    y = 4 * np.sin(x / 9)
    town.line(*np.stack([x, y - 0.0], -1))
    town.line(*np.stack([x, y + 4], -1)[::-1])
    return town


def ring():
    town = Town(speed=6.0)
    angle = np.deg2rad(np.linspace(0, 90, 20))
    centre, radius = np.array([0.0, 15.0]), 15.0
    arcs = []
    for k in range(4):
        turn = angle + k * np.pi / 2 - np.pi / 2
        arcs.append(town.line(*(centre + radius * np.stack([np.cos(turn), np.sin(turn)], -1))))
    town.join(*[(arcs[k], arcs[(k + 1) % 4]) for k in range(4)])
    for k, arm in enumerate((0, 90, 180, -90)):
        out = np.array([np.cos(np.deg2rad(arm)), np.sin(np.deg2rad(arm))])
        leave = town.line(town.lanes[arcs[k]][-1, :2], centre + 40 * out)
        enter = town.line(centre + 40 * out + [1, 1], town.lanes[arcs[k]][-1, :2])
        town.join((arcs[k], leave), (enter, arcs[(k + 1) % 4]))
    return town


def fork(angle, at=0.0, merge=False, reach=30.0):
    """A road of one lane that forks (or, read backwards, merges) at x = ``at``."""
    town = Town()
    sign = -1 if merge else 1
    main = town.line(*[(-32, 0), (at, 0)][::sign] if not merge else [(at, 0), (32, 0)])
    ends = [(at + sign * 32, 0), (at + sign * reach * np.cos(angle), reach * np.sin(angle))]
    for end in ends:
        line = [(at, 0), end]
        branch = town.line(*line[::sign])
        town.join((branch, main) if merge else (main, branch))
    return town


def side_streets():
    town = Town()
    for x in (-24, 0, 24):
        town.crossing((x, WIDTH / 2), (0, 180, -90), size=4, reach=12)
    return town


def bridge():
    town = road(1, 1)
    town.line((10, -32), (10, 32), z=7.0)
    town.line((14, 32), (14, -32), z=7.0)
    return town


def turning(turn):
    """An approach of two lanes, the one on the turn's side for turning only, the ego in it."""
    town = Town()
    side = 1 if turn == "left" else -1
    through = town.line((-32, -side * WIDTH), (8, -side * WIDTH))
    only = town.line((-32, 0), (8, 0))
    ahead = town.line((28, -side * WIDTH), (32, -side * WIDTH))
    middle = town.line((8, -side * WIDTH), (28, -side * WIDTH))
    away = town.line((18, side * 10), (18, side * 32))
    bow = town.bow((8, 0), 0, (18, side * 10), side * 90)
    town.line((14, 32), (14, -32)) if turn == "left" else town.line((14, -32), (14, 32))
    town.join((through, middle), (middle, ahead), (only, bow), (bow, away))
    spare = town.bow((8, -side * WIDTH), 0, (22, -side * 12), -side * 90)
    town.join((through, spare), (spare, town.line((22, -side * 12), (22, -side * 32))))
    return town


def lit(state):
    town = at(20, 0, (0, 90, 180, -90))
    for k, line in enumerate(town.lanes):
        if abs(line[0, 1]) < 1 and line[0, 0] < 11 and line[-1, 0] > 9:
            town.signals[k] = state
    return town


GOLDEN = {
    "two lanes, two ways": (road(), {"layout": "straight", "lanes_same": 1, "lanes_opposite": 1, "median": False}),
    "one way": (road(3, 0, ego_index=2), {"layout": "straight", "lanes_same": 3, "lanes_opposite": 0, "lane_index": 2}),
    "single lane": (road(1, 0), {"layout": "straight", "lanes_same": 1, "lanes_opposite": 0}),
    "four lanes": (road(2, 2), {"layout": "straight", "lanes_same": 2, "lanes_opposite": 2, "lane_index": 1}),
    "right lane": (road(2, 2, ego_index=2), {"lanes_same": 2, "lanes_opposite": 2, "lane_index": 2}),
    "median": (road(2, 2, gap=5.0), {"median": True, "lanes_same": 2, "lanes_opposite": 2}),
    "uneven": (road(3, 2, ego_index=3), {"lanes_same": 3, "lanes_opposite": 2, "lane_index": 3}),
    "left curve": (bend(30), {"layout": "curve", "curve": "left"}),
    "right curve": (bend(-30), {"layout": "curve", "curve": "right"}),
    "gentle curve": (bend(14), {"layout": "straight", "curve": "gently left"}),
    "winding": (winding(), {"layout": "winding", "curve": "winding"}),
    "crossroads ahead": (at(20, 0, (0, 90, 180, -90)), {"layout": "four-way", "intersection_side": "ahead",
                                                        "intersection_distance": 20}),
    "inside a crossroads": (at(0, 0, (0, 90, 180, -90)), {"layout": "four-way", "intersection_side": "inside"}),
    "crossroads behind": (at(-20, 0, (0, 90, 180, -90)), {"layout": "four-way", "intersection_side": "behind"}),
    "wide crossroads": (at(20, 0, (0, 90, 180, -90), lanes=2, size=14), {"layout": "four-way", "lanes_same": 2,
                                                                        "lanes_opposite": 2}),
    "skewed crossroads": (at(18, 0, (0, 60, 180, -120)), {"layout": "four-way"}),
    "T to the right": (at(18, 0, (0, 180, -90)), {"layout": "T", "side_streets_right": 1, "side_streets_left": 0}),
    "T to the left": (at(18, 0, (0, 180, 90)), {"layout": "T", "side_streets_left": 1}),
    "T at the end of the road": (at(18, 0, (90, 180, -90)), {"layout": "T", "ego_options": ("left", "right")}),
    "T with a lane end askew": (frayed(), {"layout": "T", "intersection": "T"}),
    "five arms": (at(10, 0, (0, 70, 120, 180, -90)), {"layout": "complex", "intersection": "complex"}),
    "side streets": (side_streets(), {"layout": "several side streets", "side_streets_right": 3}),
    "roundabout": (ring(), {"layout": "roundabout"}),
    "lane added": (fork(0.12, at=5.0), {"layout": "lane added"}),
    "lane ends": (fork(0.12, at=-5.0, merge=True), {"layout": "lane ends"}),
    "split": (fork(0.5, at=5.0), {"layout": "split"}),
    "merge": (fork(0.5, at=-5.0, merge=True), {"layout": "merge"}),
    "left-turn lane": (turning("left"), {"turn_lanes": ("left",), "ego_turn_lane": "left"}),
    "right-turn lane": (turning("right"), {"turn_lanes": ("right",), "ego_turn_lane": "right"}),
    "bridge": (bridge(), {"layout": "straight", "bridge": True, "intersection": None}),
    "green light": (lit(Signal.GO), {"layout": "four-way", "signals": "green"}),
    "red light": (lit(Signal.STOP), {"signals": "red"}),
    "no road": (Town(), {"layout": "no road", "curve": None, "lanes_same": 0}),
}  # fmt: skip


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_towns(name):
    town, expected = GOLDEN[name]
    found = extract_facts(town.scene())
    assert {key: getattr(found, key) for key in expected} == expected


def loop(line):
    """A closed line in four lanes, each of which leads into the next."""
    town = Town(speed=6.0)
    lanes = [town.line(*part) for part in line]
    town.join(*[(lanes[k], lanes[(k + 1) % 4]) for k in range(4)])
    return road_of(town.scene())


@pytest.mark.parametrize("corners", [7, 20])
@pytest.mark.parametrize("flip", [1, -1])
def test_rings_are_seen_however_few_their_corners_on_both_sides_of_the_road(corners, flip):
    quarters = [np.deg2rad(np.linspace(90 * k, 90 * k + 90, corners)) for k in range(4)]
    assert has_roundabout(loop([14 * np.stack([np.cos(turn), flip * np.sin(turn)], -1) for turn in quarters]))


def test_a_block_with_round_corners_is_no_roundabout():
    angle = np.deg2rad(np.linspace(0, 90, 8))
    corner = np.concatenate([[[9, -5]], 5 * np.stack([np.cos(angle), np.sin(angle)], -1) + [4, 4]])
    quarters = []
    for k in range(4):
        turn = np.deg2rad(90 * k)
        quarters.append(corner @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))
    assert all(np.allclose(quarters[k][-1], quarters[(k + 1) % 4][0], atol=1.01) for k in range(4))
    assert not has_roundabout(loop(quarters))


def test_there_are_thirty():
    assert len(GOLDEN) >= 30


def test_traffic_is_seen_from_the_ego():
    town = road(2, 1, ego_index=2)
    for place in ((15, 0), (-12, 0), (-20, 0), (8, WIDTH), (-20, 2 * WIDTH, 180, 5), (3, -6)):
        town.agent(*place)
    town.agent(10, -9, kind=AgentType.PEDESTRIAN).agent(10, 12, kind=AgentType.PEDESTRIAN)
    town.agent(4, -3, kind=AgentType.CYCLIST)
    found = extract_facts(town.scene()).traffic
    assert (found.vehicles, found.pedestrians, found.cyclists) == (6, 2, 1)
    assert (found.ahead, found.behind, found.left_lane, found.right_lane) == (1, 2, 1, 0)
    assert (found.oncoming, found.crossing, found.parked, found.off_road) == (1, 0, 1, 1)
    assert (found.pedestrians_left, found.pedestrians_right, found.pedestrians_near_road) == (1, 1, 1)
    assert found.ego_motion == "moderate"


def test_cars_on_the_crossing_road():
    town = at(20, 0, (0, 90, 180, -90))
    town.agent(20 + WIDTH / 2, -20, 90, 6).agent(20 - WIDTH / 2, 25, -90, 6)
    assert extract_facts(town.scene()).traffic.crossing == 2


@pytest.mark.parametrize("name", ["crossroads ahead", "left-turn lane", "lane added", "uneven", "roundabout"])
def test_order_and_padding_do_not_matter(name):
    scene = GOLDEN[name][0].agent(12, 1).agent(-9, 3, 180).scene()
    rng = np.random.default_rng(0)
    for _ in range(3):
        order = np.concatenate([[0], 1 + rng.permutation(len(scene.agents) - 1)])
        shuffled = permute(scene, order, rng.permutation(len(scene.lanes)))
        assert extract_facts(pad(shuffled, 20, 70)) == extract_facts(scene)


def test_facts_go_to_json_and_back():
    for town, _ in GOLDEN.values():
        facts = extract_facts(town.scene())
        assert Facts.from_json(json.loads(json.dumps(facts.to_json()))) == facts
    with pytest.raises(ValueError, match="format 7"):
        Facts.from_json({"format": 7})
    with pytest.raises(ValueError, match="unknown fields: colour"):
        Facts.from_json({"format": FORMAT, "layout": "T", "colour": "red"})


def test_a_tangle_of_lanes_has_no_intersections():
    """Untrained models draw such scenes; pairs of their crossings, all compared, took minutes and gigabytes."""
    scene = empty(1, 60).replace(
        lanes=np.random.default_rng(0).normal(0, 12, (60, 20, 3)).astype(np.float32), lane_mask=np.ones(60, bool),
        agent_mask=np.ones(1, bool),
    )  # fmt: skip
    assert find_intersections(road_of(scene))[0] == []
    assert extract_facts(scene).layout not in ("four-way", "T", "complex")
