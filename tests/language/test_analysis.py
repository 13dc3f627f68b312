"""The analysis of scenes: properties that hold for any scene, and lanes drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.language.analysis.crossings import find_crossings
from scjax.language.analysis.lane_lines import lane_lines
from scjax.language.analysis.routes import reachable_lanes, straightest_route
from scjax.language.analysis.scene_analysis import analyze
from scjax.language.attributes.table import measure_attributes
from scjax.scene import pad
from tests.factories.hand_drawn_scene import SceneBuilder
from tests.factories.road_scenes import bridge, curved_road, fork, intersection, roundabout, straight_road, winding_road

SCENES = {
    "straight": lambda: straight_road(2, 1).scene(),
    "curve": lambda: curved_road(40).scene(),
    "winding": lambda: winding_road().scene(),
    "four-way": lambda: intersection(12, 0, (0, 90, 180, -90)).scene(),
    "T": lambda: intersection(12, 0, (0, 180, -90)).scene(),
    "roundabout": lambda: roundabout().scene(),
    "split": lambda: fork(0.3).scene(),
    "bridge": lambda: bridge().scene(),
}
SWAP = {"left": "right", "right": "left", "leftmost": "rightmost", "rightmost": "leftmost"}


def mirrored(scene):
    """The scene in a mirror along the x axis."""
    agents, lanes = np.array(scene.agents), np.array(scene.lanes)
    agents[:, 1], agents[:, 5], lanes[..., 1] = -agents[:, 1], -agents[:, 5], -lanes[..., 1]
    return scene.replace(agents=agents, lanes=lanes)


@pytest.mark.parametrize("name", SCENES)
def test_mirror_swaps_left_and_right_and_changes_nothing_else(name):
    scene = SCENES[name]()
    own, other = measure_attributes(scene), measure_attributes(mirrored(scene))
    own["left_lane"], own["right_lane"] = own["right_lane"], own["left_lane"]
    for key in ("bend", "ego_manoeuvre", "ego_lane"):
        own[key] = tuple(SWAP.get(value, value) for value in own[key])
    own["turn_lane"] = tuple(sorted(SWAP[value] for value in own["turn_lane"]))
    del own["ego_lane_index"], other["ego_lane_index"]
    assert own == other


@pytest.mark.parametrize("name", SCENES)
def test_padding_and_order_of_lanes_do_not_matter(name):
    scene = SCENES[name]()
    order = np.random.default_rng(0).permutation(len(scene.lane_mask))
    shuffled = scene.replace(
        lanes=scene.lanes[order],
        lane_mask=scene.lane_mask[order],
        lane_known=scene.lane_known[order],
        signals=scene.signals[order],
        links=scene.links[np.ix_(order, order)],
    )
    assert measure_attributes(pad(shuffled, 9, 60)) == measure_attributes(scene)


def test_lines_keep_length_and_ends():
    lines = lane_lines(curved_road(90).scene())
    last = lines.points[np.arange(len(lines)), lines.count - 1]
    np.testing.assert_allclose(last, lines.raw[:, -1], atol=1e-6)
    np.testing.assert_allclose(lines.points[:, 0], lines.raw[:, 0], atol=1e-6)
    assert (lines.spacing <= 1.0).all()
    np.testing.assert_allclose(np.abs(lines.turn), np.pi / 2, atol=0.1)


def test_ends_that_meet_follow_each_other_without_a_link():
    builder = SceneBuilder()
    first, second, away = (
        builder.add_lane((-30, 0), (0, 0)),
        builder.add_lane((0.5, 0), (30, 0)),
        builder.add_lane((2.0, 0), (30, 3)),
    )
    lines = lane_lines(builder.scene())
    assert lines.next[first] == [second]
    assert not lines.previous[away]


def test_straightest_route_goes_straight_on_and_all_branches_are_reachable():
    scene = intersection(12, 0, (0, 90, 180, -90)).scene()
    analysis = analyze(scene)
    route = analysis.route
    assert route is not None
    assert abs(route.ahead.points[-1, 1]) < 0.5
    assert route.ahead.length == pytest.approx(32, abs=1.5)
    reachable = reachable_lanes(analysis.lines, route.lane, route.point, 40.0)
    assert set(route.ahead.lanes[1:]) < set(reachable)
    assert list(reachable.values()) == sorted(reachable.values())


def test_route_ends_where_lanes_end():
    builder = SceneBuilder()
    lane = builder.add_lane((-10, 0), (12, 0))
    assert straightest_route(lane_lines(builder.scene()), lane, 0, 50.0).length == pytest.approx(22.0)


@pytest.mark.parametrize(("height", "level", "over"), [(0.0, 1, 0), (2.0, 1, 0), (3.0, 0, 0), (5.0, 0, 1)])
def test_crossings_by_height(height, level, over):
    builder = SceneBuilder()
    builder.add_lane((-20, 0), (20, 0))
    builder.add_lane((3, -20), (3, 20), z=height)
    crossings = find_crossings(lane_lines(builder.scene()))
    assert len(crossings.at_level().points) == level
    assert len(crossings.over().points) == over
    np.testing.assert_allclose(crossings.points[:, :2], [[3, 0]], atol=1e-5)


@pytest.mark.parametrize("arms", [(0, 180, -90), (0, 90, 180, -90)])
def test_crossroad_has_the_arms_that_were_drawn(arms):
    (crossroad,) = analyze(intersection(8, 0, arms).scene()).crossroads
    drawn = np.sort(np.deg2rad(arms))
    turned = np.sort((np.array(crossroad.arms) + 0.1) % (2 * np.pi))
    np.testing.assert_allclose(turned, np.sort((drawn + 0.1) % (2 * np.pi)), atol=0.1)
    np.testing.assert_allclose(crossroad.center, (8, 0), atol=3)


def test_stem_of_a_t_is_the_arm_without_a_partner():
    (crossroad,) = analyze(intersection(8, 0, (0, 180, -90)).scene()).crossroads
    assert crossroad.stem == pytest.approx(-np.pi / 2, abs=0.1)


def test_ring_is_where_it_was_drawn():
    ring = analyze(roundabout().scene()).ring
    assert ring is not None
    np.testing.assert_allclose(ring.center, (0, 15), atol=0.5)
    assert ring.radius == pytest.approx(15, abs=0.5)
