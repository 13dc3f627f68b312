"""Kinds of the tokens of a scene to sample: those of an outline, with agents fitted to the request."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

import scjax
from scjax.generate.agent_draw import AgentDraw
from scjax.generate.conditions import Condition
from scjax.generate.counts import CountTables
from scjax.generate.model import load_model, save_model
from scjax.generate.outline_draw import draw_outline
from scjax.generate.requests import draw_candidates, draw_request
from scjax.generate.scene_spec import specify_scene
from scjax.language.attributes.table import check_attributes
from scjax.models import codec as presets
from scjax.models.denoiser.kinds import LANE_DIGITS, NO_KIND, agent_digits, agent_kinds, lane_kinds
from scjax.scene import AgentType, Crop
from tests.factories.outlines import outlines
from tests.factories.repair_scenes import chain, queue
from tests.factories.traffic import agent, lane, scene
from tests.factories.worlds import tiny_model

CODEC = presets.scjax()
CLASSES = agent_digits(CODEC)[0]
CAR, PERSON, CYCLIST, CONE = (
    CODEC.agent_types.index(AgentType[name]) for name in ("VEHICLE", "PEDESTRIAN", "CYCLIST", "STATIC")
)
BUS, STANDING_CAR = CLASSES - 1, CAR + CLASSES
ROWS = [
    ((1, 2), (CAR, STANDING_CAR, CAR, PERSON), {"vehicles": 2, "pedestrians": 1, "layout": ("T",)}),
    ((1, 2, 3), (CAR, CYCLIST, BUS, CONE), {"cyclists": 1, "vehicles": 1, "large": 1, "static": 1}),
]


def _model(**changes):
    model = tiny_model(agent_kinds=agent_digits(CODEC), lane_kinds=LANE_DIGITS, **changes)
    return dataclasses.replace(model, outlines=outlines(*ROWS))


def _outline(request=None, known=None, seed=0, **options):
    model = _model()
    condition = Condition(attributes=check_attributes(request or {}), known=known, **options)
    return draw_outline(np.random.default_rng(seed), specify_scene(condition, {}, model), model)


def _numbers(request=None, **options):
    """Of the agents besides the ego: vehicles, people, cyclists, static objects, large vehicles."""
    classes = _outline(request, **options).agents[1:] % CLASSES
    cars, buses = (classes == CAR).sum(), (classes == BUS).sum()
    return [cars + buses, *((classes == one).sum() for one in (PERSON, CYCLIST, CONE)), buses]


def test_kinds_are_those_of_a_scene_that_fulfills_the_request():
    outline = _outline({"layout": "T"})
    assert outline.agents.tolist() == list(ROWS[0][1]) and outline.lanes.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        ({"layout": "T", "vehicles": 5}, [5, 1, 0, 0, 0]),
        ({"layout": "T", "vehicles": 0}, [0, 1, 0, 0, 0]),
        ({"layout": "T", "large": 1, "vehicles": 2}, [2, 1, 0, 0, 1]),
        ({"layout": "T", "vehicles": 2, "pedestrians": 0}, [2, 0, 0, 0, 0]),
        ({"layout": "T", "vehicles": 2, "cyclists": [2, 3]}, [2, 1, 2, 0, 0]),
        ({"layout": "T", "event": ["work-zone"]}, [2, 1, 0, 3, 0]),
        ({"layout": "T", "parked": 4}, [4, 1, 0, 0, 0]),
        ({"cyclists": 1, "static": 1, "large": 0}, [0, 0, 1, 1, 0]),
    ],
)
def test_agents_are_added_and_left_out_to_the_numbers_of_the_request(request_, expected):
    for seed in range(5):
        assert _numbers(request_, seed=seed) == expected


def _kind(class_, *, speed=1, direction=0, lane=1, side=0, distance=1):
    kind, step = 0, 1
    for digit, size in zip((class_, speed, direction, lane, side, distance), agent_digits(CODEC), strict=True):
        kind, step = kind + digit * step, step * size
    return kind


AHEAD, BEHIND, ASIDE, WALKER = _kind(CAR, side=1), _kind(CAR, side=2), _kind(CAR, lane=0), _kind(PERSON, lane=1)


def _fitted(kinds, request, missed=(), seed=0):
    others = np.array([[CAR, AHEAD, BEHIND, ASIDE, WALKER, PERSON]])
    draw = AgentDraw(np.random.default_rng(seed), others, CODEC, check_attributes(request))
    return draw.fit(np.array(kinds), missed).tolist()


def test_agents_that_the_request_names_are_left_out_last():
    for seed in range(8):
        kinds = [CAR, BEHIND, ASIDE, ASIDE, AHEAD]
        assert _fitted(kinds, {"vehicles": 2, "ahead": 1, "behind": 1}, seed=seed) == [CAR, BEHIND, AHEAD]
        assert AHEAD not in _fitted(kinds, {"vehicles": 3, "ahead": 0}, seed=seed)


def test_agents_that_are_added_are_none_that_the_request_counts_elsewhere():
    for seed in range(8):
        assert _fitted([CAR, AHEAD], {"vehicles": 4, "ahead": 1}, seed=seed).count(AHEAD) == 1


def test_agents_become_those_of_a_place_that_the_scene_does_not_show():
    for seed in range(8):
        kinds = _fitted([CAR, ASIDE, ASIDE, PERSON], {"vehicles": 2, "behind": 2}, {"behind"}, seed)
        assert sorted(kinds[1:]) == sorted([BEHIND, BEHIND, PERSON])
        kinds = _fitted([CAR, AHEAD, BEHIND], {"ahead": 0}, {"ahead"}, seed)
        assert AHEAD not in kinds and len(kinds) == 3
        kinds = _fitted([CAR, PERSON], {"pedestrians_on_road": 1}, {"pedestrians_on_road"}, seed)
        assert kinds == [CAR, WALKER]


def test_numbers_of_places_that_kinds_do_not_show_are_counted():
    kinds = np.array([[CAR, AHEAD, BEHIND], [CAR, AHEAD, AHEAD], [CAR, NO_KIND, NO_KIND]])

    def misses(request):
        draw = AgentDraw(np.random.default_rng(0), kinds, CODEC, check_attributes(request))
        return draw.count_misses(kinds).tolist()

    assert misses({"ahead": 1, "behind": 0}) == [1, 1, 1]
    assert misses({"ahead": [1, None], "vehicles": 9}) == [0, 0, 1]


def test_numbers_of_the_condition_hold():
    outline = _outline(num_agents=7, num_lanes=4)
    assert len(outline.agents) == 7 and (outline.agents == NO_KIND).sum() == 3
    assert len(outline.lanes) == 4 and outline.lanes[-1] == NO_KIND
    outline = _outline(num_agents=2, num_lanes=1)
    assert len(outline.agents) == 2 and len(outline.lanes) == 1
    assert outline.agents[0] == CAR


def test_known_agents_come_first_and_count():
    known = queue(6.0, cars=3)
    outline = _outline({"layout": "T", "vehicles": 5}, known=known)
    assert outline.agents[:3].tolist() == agent_kinds(known, CODEC).tolist()
    assert (outline.agents[1:] % CLASSES == CAR).sum() == 5


def test_of_known_lanes_alone_the_kind_is_known():
    known = chain(0.0)
    assert _outline(known=known).lanes.tolist() == lane_kinds(known).tolist()


def test_on_known_lanes_the_roads_of_a_request_do_not_choose_the_outline():
    known = scene([agent(0, 0)], [lane((-9, 0), (9, 0)), lane((9, 4), (-9, 4))])
    drawn = [
        _outline({"layout": layout, "cyclists": 1}, known=known, seed=1, num_lanes=2).agents.tolist()
        for layout in ("T", "roundabout")
    ]
    assert drawn[0] == drawn[1] and CYCLIST in np.array(drawn[0][1:]) % CLASSES


def test_the_network_decides_on_other_windows_and_without_outlines():
    assert _outline(crop=Crop.FORWARD) is None
    without = dataclasses.replace(_model(), outlines=None)
    assert draw_outline(np.random.default_rng(0), specify_scene(Condition(), {}, without), without) is None


def test_scenes_have_the_numbers_of_their_outline(tmp_path):
    """Also of a model that was written and read."""
    model = load_model(save_model(_model(), tmp_path / "model"))
    condition = Condition(attributes={"pedestrians": (1, 1)})
    request = draw_request(jax.random.key(0), specify_scene(condition, {}, model), model, CountTables(model))
    assert (request.num_agents, request.num_lanes) == (4, 2)
    scene = scjax.sample(jax.random.key(0), condition, model=model, num_steps=2)[0]
    assert (scene.num_agents, scene.num_lanes) == (4, 2)


def test_candidates_have_outlines_of_their_own():
    model = _model()
    tables, key = CountTables(model), jax.random.key(0)
    spec = specify_scene(Condition(attributes={"signal": "none"}), {}, model)
    drawn = draw_candidates(key, spec, model, tables, 8)
    assert {one.num_lanes for one in drawn} == {2, 3}
    assert drawn[0].num_lanes == draw_request(key, spec, model, tables).num_lanes
    of_no_request = draw_candidates(key, specify_scene(Condition(), {}, model), model, tables, 8)
    assert len({one.num_lanes for one in of_no_request}) == 1


def test_scenes_with_known_lanes_are_sampled():
    known = queue(6.0, cars=3)
    condition = Condition(known=known, num_agents=4, num_lanes=int(known.num_lanes) + 1)
    scene = scjax.sample(jax.random.key(0), condition, model=_model(), num_steps=2)[0]
    np.testing.assert_array_equal(scene.agents[:3], known.agents[:3])


def test_kinds_change_what_is_sampled():
    condition = Condition(num_lanes=2, num_agents=4)
    scenes = [
        scjax.sample(jax.random.key(0), condition, model=model, num_steps=2)[0]
        for model in (_model(), dataclasses.replace(_model(), outlines=None))
    ]
    assert np.abs(scenes[0].agents - scenes[1].agents).max() > 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lanes": np.full((2, 4), 60_000, np.int32)}, "lanes has kinds that the denoiser does not know"),
        ({"agents": np.full((2, 8), -2, np.int16)}, "agents has kinds that the denoiser does not know"),
        ({"domains": np.full(2, 9, np.int16)}, "domains are outside those of the model"),
        ({"agents": np.zeros((2, 200), np.int16)}, "fewer lanes or agents at most"),
    ],
)
def test_faulty_outlines_are_not_saved(change, message, tmp_path):
    faulty = dataclasses.replace(outlines(*ROWS), **change)
    with pytest.raises(ValueError, match=message):
        save_model(dataclasses.replace(_model(), outlines=faulty), tmp_path / "model")
