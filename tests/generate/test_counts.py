"""Lane and agent counts: from the prompt by the count predictor, where the condition leaves them open."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

import scjax
from scjax.generate.conditions import Condition, Stream
from scjax.generate.counts import CountTables
from scjax.generate.requests import draw_request
from scjax.generate.scene_spec import specify_scene
from scjax.language.attributes.vector import feature_names
from scjax.models.counts.predictor import CountPredictorConfig, count_predictor
from scjax.models.denoiser.config import TextCondition
from scjax.scene import Crop
from tests.factories.words import Words
from tests.factories.worlds import tiny_model


def with_predictor(biases, **changes):
    """A text model whose count predictor ignores the prompt: its logits are the biases {name: {count: logit}}."""
    sizes = {"text_width": Words.width, "domains": 2, "width": 8, "queries": 1, "heads": 1}
    config = CountPredictorConfig(**{**sizes, "max_lanes": 100, "max_agents": 61, **changes})
    params = count_predictor(config).init(jax.random.key(0))
    for name, logits in biases.items():
        bias = np.full(len(params[name]["bias"]), -50.0, np.float32)
        bias[list(logits)] = list(logits.values())
        params[name] = {**params[name], "kernel": np.zeros_like(params[name]["kernel"]), "bias": bias}
    model = tiny_model(TextCondition(Words.width))
    model = dataclasses.replace(model, text_encoder=Words.name, prompts={"a road": Words.features("a road")})
    return model.with_component("count_predictor", config, params)


@pytest.fixture(scope="module")
def seven_lanes():
    return with_predictor({"lanes": {7: 0.0}, "agents": {3: 0.0}})


def test_counts_follow_the_prompt(seven_lanes):
    scene = scjax.sample(jax.random.key(0), Condition(prompt="a road"), model=seven_lanes, num_steps=3)
    assert (scene.num_lanes, scene.num_agents) == (7, 3)


def test_counts_of_the_condition_win(seven_lanes):
    condition = Condition(prompt="a road", num_agents=5)
    scene = scjax.sample(jax.random.key(0), condition, model=seven_lanes, num_steps=3)
    assert (scene.num_lanes, scene.num_agents) == (7, 5)


@pytest.mark.parametrize(("sharpness", "lanes"), [(1.0, {2, 3}), (100.0, {2})])
def test_sharp_counts_are_the_likely_ones(sharpness, lanes):
    logits = {2: 0.3, 3: 0.0}
    model = with_predictor({"lanes": logits, "agents": logits}, max_lanes=9, max_agents=5, sharpness=sharpness)
    streams, tables = {"text": Stream(model.prompts["a road"])}, CountTables(model)
    spec = specify_scene(Condition(), streams, model)
    requests = [draw_request(jax.random.fold_in(jax.random.key(0), i), spec, model, tables) for i in range(30)]
    assert {request.num_lanes for request in requests} == lanes


def test_count_tables_evaluate_equal_texts_once(seven_lanes):
    tables = CountTables(seven_lanes)
    one, same = (Stream(Words.features("a road")) for _ in range(2))
    assert tables(one, {}, None, Crop.CENTERED) is tables(same, {}, None, Crop.CENTERED)
    assert tables(one, {}, None, Crop.CENTERED) is not tables(one, {}, 1, Crop.CENTERED)


def test_count_tables_are_the_datas_without_a_prompt(seven_lanes):
    tables = CountTables(seven_lanes)
    assert tables(None, {}, None, Crop.CENTERED) is seven_lanes.counts
    assert tables(Stream(Words.features("a road")), {}, None, Crop.FORWARD) is seven_lanes.counts


def test_counts_follow_the_attributes_where_the_network_reads_them():
    """The bias of the network allows 2 to 5 agents; a request for more than that sets a lower bound."""
    names = feature_names()
    model = with_predictor({"lanes": {7: 0.0}, "agents": {2: 0.0, 5: 0.0}}, text_width=len(names), attributes=names)
    tables = CountTables(model)
    assert tables.read_attributes and not CountTables(tiny_model()).read_attributes
    assert tables(None, {}, None, Crop.CENTERED) is model.counts
    assert tables(None, {"layout": "T"}, None, Crop.CENTERED) is not model.counts

    def agents(**condition):
        keys = (jax.random.fold_in(jax.random.key(0), i) for i in range(20))
        spec = specify_scene(Condition(**condition), {}, model)
        requests = [draw_request(key, spec, model, tables) for key in keys]
        assert {request.num_lanes for request in requests} == {7}
        return {request.num_agents for request in requests}

    assert agents(attributes={"layout": "T"}) == {2, 5}
    assert agents(attributes={"vehicles": (2, None), "static": 1}) == {5}
    assert agents(attributes={"vehicles": (2, None)}, num_agents=2) == {2}
