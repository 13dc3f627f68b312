"""``scjax.place``, ``regenerate_agents``, ``regenerate_region``: what stays, what is added; on an untrained model."""

from __future__ import annotations

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.generate.conditions import Condition
from scjax.generate.place import placement_condition, window_of_map
from scjax.models.denoiser.kinds import lane_kinds
from scjax.scene import Crop, Scene, unpadded, validate, validate_map
from tests.factories.examples import example_batch, example_scene
from tests.factories.maps import two_tile_map
from tests.factories.traffic import agent, lane, scene
from tests.factories.worlds import tiny_model

LANE_FIELDS = ("lanes", "lane_mask", "lane_known", "signals", "links", "crop", "domain")
AGENT_FIELDS = ("agents", "agent_types", "agent_mask", "agent_known")
STREET = scene(
    [agent(0, 0), agent(12, 0), agent(-12, 0), agent(20, 4, 180)],
    [lane((-30, 0), (0, 0)), lane((0, 0), (30, 0)), lane((30, 4), (-30, 4))],
    joined=[(0, 1)],
)


@pytest.fixture(scope="module")
def model():
    return tiny_model()


def options(model, **changes):
    return {"model": model, "num_steps": 2, **changes}


def assert_lanes_stay(before: Scene, after: Scene):
    for name in LANE_FIELDS:
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), err_msg=name)


def assert_agents_stay(before: Scene, after: Scene, rows):
    for name in AGENT_FIELDS:
        np.testing.assert_array_equal(getattr(after, name)[rows], getattr(before, name)[rows], err_msg=name)


@pytest.mark.parametrize(("keep", "kept"), [(True, 4), (False, 1)])
def test_lanes_and_kept_agents_stay_bit_for_bit(model, keep, kept):
    placed = validate(scjax.place(0, STREET, num_agents=6, keep_agents=keep, **options(model)))
    assert placed.num_agents == 6
    assert_lanes_stay(STREET, placed)
    assert_agents_stay(STREET, placed, slice(kept))


def test_a_scene_alone_equals_the_first_of_several(model):
    other = unpadded(example_scene(1, agents=2, lanes=4))
    alone = scjax.place(3, STREET, num_agents=6, **options(model))
    several = scjax.place(3, [STREET, other], num_agents=6, **options(model))
    chex.assert_trees_all_close(alone.to_dict(), several[0].to_dict(), atol=2e-3)
    assert_lanes_stay(other, several[1])


def test_placement_is_sampling_with_all_lanes_known(model):
    condition = placement_condition(STREET, Condition(domain="there"), model, num_agents=6)
    expected = scjax.sample(jax.random.key(0), [condition], **options(model))[0]
    placed = scjax.place(0, STREET, Condition(domain="there"), num_agents=6, **options(model))
    np.testing.assert_array_equal(placed.agents, expected.agents)


def test_map_gets_the_agents_of_its_window(model):
    map = two_tile_map()
    placed = validate_map(scjax.place(0, map, at=(20.0, -2.0, 0.5), num_agents=4, ego_speed=3.0, **options(model)))
    assert placed.lanes == map.lanes and placed.tiles == map.tiles
    assert placed.agent_ids == ("car", "placed.agent-0", "placed.agent-2", "placed.agent-3")
    np.testing.assert_array_equal(placed.agents[:1], map.agents)
    np.testing.assert_allclose(placed.agents[1, [0, 1, 3, 4, 5]], [20, -2, 3, np.cos(0.5), np.sin(0.5)], atol=1e-5)
    window = scjax.crop_map(placed, agent="placed.agent-0", off_road=True)
    again = scjax.place(0, window_of_map(map, (20.0, -2.0, 0.5), 3.0), num_agents=4, **options(model))
    order = np.argsort(np.linalg.norm(again.agents[:, :2], axis=-1))
    inside = np.abs(again.agents[order, :2]).max(-1) <= 32
    np.testing.assert_allclose(window.agents[:, :2], again.agents[order][inside][:, :2], atol=1e-3)


def test_map_gets_agents_around_one_of_its_own(model):
    placed = scjax.place(0, two_tile_map(), at="car", num_agents=3, **options(model))
    assert placed.agent_ids == ("car", "placed.agent-1", "placed.agent-2")
    twice = scjax.place(1, placed, at="car", num_agents=2, keep_agents=False, **options(model))
    assert twice.agent_ids[0] == "car" and twice.agent_ids[-1].endswith("agent-1")


def crowd(agents):
    return scene([agent(0, 0), *(agent(-25 + 5 * (k % 10), 5 * (k // 10) - 25) for k in range(agents))], STREET.lanes)


@pytest.mark.parametrize(
    ("arguments", "given", "message"),
    [
        ((scene([agent(0, 0)]),), {}, "map_or_scene has no lanes"),
        ((scene([agent(0, 0)], [lane((0, k), (9, k)) for k in range(101)]),), {}, "101 lanes are more than the 100"),
        ((crowd(70),), {}, "71 agents are more than the 61"),
        ((STREET,), {"num_agents": 62}, "62 agents are more than the 61"),
        ((scene([agent(0, 0), agent(9, 0), agent(9.5, 0)], STREET.lanes),), {}, "agents 1 and 2 are inside each other"),
        ((STREET,), {"num_agents": 3}, r"num_agents must be a whole number in 4\.\."),
        ((STREET,), {"at": (1.0, 2.0)}, "at is for maps"),
        ((example_batch(2),), {}, "not a batch"),
        ((STREET, Condition(known=STREET)), {}, "condition.known follows"),
        ((STREET, Condition(num_lanes=3)), {}, "condition.num_lanes follows"),
        ((STREET, Condition(crop=Crop.FORWARD)), {}, "condition.crop follows"),
        ((two_tile_map(),), {}, "at is missing"),
        ((two_tile_map(),), {"at": (1.0,)}, r"at must be \(x, y\)"),
        ((two_tile_map(),), {"at": (900.0, 900.0)}, "at: no lane is within 150 m"),
        ((two_tile_map(),), {"at": (32.0, 90.0)}, "at: no lane for cars is in the window"),
        ((two_tile_map(),), {"at": "bus"}, "at: agent is 'bus': the map has no such agent"),
        ((two_tile_map(),), {"at": (1.0, -2.0)}, "agents 0 and 1 are inside each other"),
    ],
)
def test_place_names_what_is_wrong(model, arguments, given, message):
    with pytest.raises(ValueError, match=message):
        scjax.place(0, *arguments, **given, model=model)


def test_agents_drawn_anew_take_the_places_of_the_old(model):
    after = validate(scjax.regenerate_agents(0, STREET, [1, 3], **options(model)))
    assert_lanes_stay(STREET, after)
    assert_agents_stay(STREET, after, [0, 2])
    assert after.num_agents == 4 and not np.isclose(after.agents[[1, 3], :2], STREET.agents[[1, 3], :2]).any()
    chex.assert_trees_all_equal(scjax.regenerate_agents(0, STREET, [], model=model).to_dict(), STREET.to_dict())


def test_a_region_is_filled_anew(model):
    region = [(5, -32), (32, -32), (32, 32), (5, 32)]
    after = validate(scjax.regenerate_region(0, STREET, region, best_of=4, **options(model)))
    assert_lanes_stay(STREET, after)
    kept = scjax.remove_agents(STREET, [1, 3])
    assert_agents_stay(kept, after, slice(2))
    assert after.num_agents <= 4 and (after.agents[2:, 0] >= 5).all()
    empty = scjax.regenerate_region(0, STREET, (5, -32, 32, 32), num_agents=0, model=model)
    chex.assert_trees_all_equal(empty.to_dict(), kept.to_dict())


def test_lanes_of_a_region_are_drawn_anew(model):
    after = validate(
        scjax.regenerate_region(0, STREET, (2, -3, 32, 3), lanes=True, num_agents=0, best_of=1, **options(model))
    )
    assert after.num_lanes == 3 and after.num_agents == 3
    np.testing.assert_array_equal(after.lanes[:2], STREET.lanes[[0, 2]])
    np.testing.assert_array_equal(after.links[:2, :2], STREET.links[np.ix_([0, 2], [0, 2])])
    assert np.abs(after.lanes[2] - STREET.lanes[1]).max() > 1e-3


@pytest.mark.parametrize("agents", [0, [1, 9]])
def test_agents_that_cannot_be_drawn_anew_are_refused(model, agents):
    with pytest.raises(ValueError, match="agents"):
        scjax.regenerate_agents(0, STREET, agents, model=model)


def test_kinds_of_lanes_without_an_ego_are_those_around_the_origin():
    assert lane_kinds(scene([], STREET.lanes)).tolist() == lane_kinds(scene([agent(0, 0)], STREET.lanes)).tolist()
