"""Kinds of the agents of a scene to sample: as many as drawn, the ego and known agents first."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

import scjax
from scjax.generate.conditions import Condition
from scjax.generate.counts import CountTables
from scjax.generate.kinds import draw_kinds
from scjax.generate.model import load_model, save_model
from scjax.generate.requests import draw_request
from scjax.models.counts.kinds import KINDS, kind_table
from scjax.models.denoiser.agent_kinds import num_kinds
from scjax.scene import AgentType, Crop
from tests.factories.repair_scenes import queue
from tests.factories.worlds import tiny_model

ROWS = [(4, 2, 0, 1, 1), (2, 0, 1, 0, 0), (6, 1, 0, 0, 2)]


def _model(**changes):
    model = tiny_model(agent_kinds=num_kinds(tiny_model().codec), **changes)
    return dataclasses.replace(model, kind_counts=kind_table([dict(zip(KINDS, row, strict=True)) for row in ROWS]))


def _kinds(condition, known=None, seed=0):
    model = _model()
    return draw_kinds(np.random.default_rng(seed), condition, known, model, model.counts)


def _numbers(kinds):
    """Of the agents besides the ego: vehicles that are not large, people, cyclists, static objects, large vehicles."""
    types = list(_model().codec.agent_types)
    order = [types.index(AgentType[name]) for name in ("VEHICLE", "PEDESTRIAN", "CYCLIST", "STATIC")]
    return [(kinds[1:] == one).sum() for one in [*order, len(types)]]


def test_kinds_are_those_of_a_row_that_fulfills_the_request():
    kinds = _kinds(Condition(attributes={"vehicles": (4, 4)}))
    assert len(kinds) == 8 and _numbers(kinds) == [3, 2, 0, 1, 1]
    assert _numbers(_kinds(Condition(attributes={"cyclists": (1, None)}))) == [2, 0, 1, 0, 0]


def test_the_order_of_other_agents_is_random():
    orders = {tuple(_kinds(Condition(num_agents=8), seed=seed).tolist()) for seed in range(20)}
    assert len(orders) > 5 and {order[0] for order in orders} == {0}


def test_known_agents_come_first_and_count():
    kinds = _kinds(Condition(attributes={"vehicles": (6, 6)}), known=queue(6.0, cars=3))
    assert kinds[:3].tolist() == [0, 0, 0] and _numbers(kinds) == [4, 1, 0, 0, 2]


@pytest.mark.parametrize("condition", [Condition(crop=Crop.FORWARD), Condition(num_agents=30)])
def test_the_network_decides_where_nothing_is_known(condition):
    assert _kinds(condition) is None


def test_scenes_have_as_many_agents_as_kinds(tmp_path):
    """Also of a model that was written and read."""
    model = load_model(save_model(_model(), tmp_path / "model"))
    np.testing.assert_array_equal(model.kind_counts, _model().kind_counts)
    condition = Condition(attributes={"pedestrians": (1, 1)}, num_lanes=3)
    request = draw_request(jax.random.key(0), condition, {}, model, CountTables(model))
    assert request.num_agents == len(request.agent_kinds) == 8
    scene = scjax.sample(jax.random.key(0), condition, model=model, num_steps=2)[0]
    assert scene.num_agents == 8


def test_kinds_change_what_is_sampled():
    condition = Condition(num_lanes=3, num_agents=8)
    scenes = [
        scjax.sample(jax.random.key(0), condition, model=model, num_steps=2)[0]
        for model in (_model(), dataclasses.replace(_model(), kind_counts=None))
    ]
    assert np.abs(scenes[0].agents - scenes[1].agents).max() > 1e-3


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (np.zeros((2, 3), np.int32), "kind_counts has shape"),
        (np.zeros((1, 6)), "kind_counts must hold whole numbers"),
        (np.array([[1, 0, 0, 0, 2, 1]], np.int32), "kind_counts: more large vehicles than vehicles"),
        (np.array([[1, 0, 0, -1, 0, 1]], np.int32), "kind_counts must hold whole numbers"),
    ],
)
def test_faulty_tables_are_not_saved(table, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        save_model(dataclasses.replace(_model(), kind_counts=table), tmp_path / "model")
