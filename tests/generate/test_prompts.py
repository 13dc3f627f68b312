"""Prompts reach the network: encoded once, from the model's own where it has them; negative ones act."""

from __future__ import annotations

import dataclasses

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.encoders.text import Tokens
from scjax.generate.conditions import Condition
from scjax.generate.prompt_cache import load_prompts, write_prompts
from scjax.generate.prompts import best, encode_prompts, prompt_warnings
from scjax.generate.sample import with_counts
from scjax.models.counts.predictor import CountPredictorConfig, count_predictor
from scjax.models.denoiser.config import TextCondition
from tests.factories.repair_scenes import chain, queue
from tests.factories.worlds import tiny_model

WIDTH = 5


class Words:
    """An encoder: every word is a token, its features are drawn from its letters."""

    name, width = "words-1", WIDTH

    def __init__(self):
        self.calls = []

    def __call__(self, texts):
        self.calls += texts
        return [Tokens(np.stack([self.word(word) for word in text.split()]), tuple(text.split())) for text in texts]

    def is_cut(self, text):
        return len(text.split()) > 50

    @staticmethod
    def word(word):
        return np.random.default_rng(list(word.encode())).normal(size=WIDTH).astype(np.float32)


@pytest.fixture(scope="module")
def model():
    features = Words()(["a road"])[0].features
    return dataclasses.replace(
        tiny_model(TextCondition(WIDTH)), text_encoder="words-1", prompts={"a road": features}
    )  # fmt: skip


def draw(model, condition, seed=0, **options):
    return scjax.sample(jax.random.key(seed), condition, model=model, steps=3, **options)


def test_each_text_is_encoded_once(model):
    encoder = Words()
    wanted = [Condition(prompt="two  cars "), Condition(prompt="two cars", negative_prompt="rain"), Condition()]
    told = encode_prompts(wanted, model, encoder)
    assert encoder.calls == ["two cars", "rain"]
    np.testing.assert_array_equal(told[0].tokens, told[1].tokens)
    assert told[1].negative_tokens.shape == (1, WIDTH) and told[2].tokens is None
    assert told[0].prompt is None


def test_a_prompt_of_the_model_needs_no_encoder(model):
    (told,) = encode_prompts([Condition(prompt="a road")], model)
    assert told.tokens.shape == (2, WIDTH)


def test_refusals(model):
    with pytest.raises(ValueError, match="not trained on text"):
        encode_prompts([Condition(prompt="a road")], tiny_model())
    other = Words()
    other.name = "words-2"
    with pytest.raises(ValueError, match="words-2, but this model was trained with words-1"):
        encode_prompts([Condition(prompt="a street")], model, other)
    with pytest.raises(ValueError, match="prompt is empty"):
        encode_prompts([Condition(prompt="  ")], model)
    with pytest.raises(ValueError, match="both given"):
        Condition(prompt="a road", tokens=np.zeros((2, WIDTH)))


def test_a_long_prompt_is_cut_with_a_warning(model):
    with pytest.warns(UserWarning, match="10000 words is too long"):
        encode_prompts([Condition(prompt="road " * 10_000)], model, Words())


def test_prompts_and_negative_prompts_change_the_scene(model):
    fixed = {"num_lanes": 6, "num_agents": 4, "domain": 0}
    road, cars = (Words()([text])[0].features for text in ("a road", "many cars"))
    plain = draw(model, Condition(prompt="a road", **fixed), guidance=2.0)
    same = draw(model, Condition(tokens=road, **fixed), guidance=2.0)
    chex.assert_trees_all_equal(plain.to_dict(), same.to_dict())
    other = draw(model, Condition(tokens=cars, **fixed), guidance=2.0)
    away = draw(model, Condition(tokens=road, negative_tokens=cars, **fixed), guidance=2.0)
    assert not np.allclose(plain.lanes, other.lanes) and not np.allclose(plain.lanes, away.lanes)
    # Away from the prompt itself: both branches say the same but for the label, so guidance does nothing more.
    alone = draw(model, Condition(tokens=road, **fixed), guidance=1.0)
    assert not np.allclose(away.lanes, alone.lanes)


def test_scenes_without_a_negative_prompt_are_not_touched_by_others(model):
    fixed = {"num_lanes": 6, "num_agents": 4, "domain": 0}
    road, cars = (Words()([text])[0].features for text in ("a road", "many cars"))
    plain, away = Condition(tokens=road, **fixed), Condition(tokens=road, negative_tokens=cars, **fixed)
    key, options = jax.random.key(4), {"model": model, "steps": 3, "guidance": 2.0}
    alone = scjax.sample_many(key, [plain, plain], **options)[0]
    among = scjax.sample_many(key, [plain, away], **options)[0]
    chex.assert_trees_all_close(alone.to_dict(), among.to_dict(), atol=2e-3)


def test_counts_follow_the_prompt(model):
    config = CountPredictorConfig(
        text_width=WIDTH, domains=2, width=8, queries=1, heads=1, max_lanes=100, max_agents=61
    )
    params = count_predictor(config).init(jax.random.key(0))
    for name, number in (("lanes", 7), ("agents", 3)):
        params[name]["kernel"] = np.zeros_like(params[name]["kernel"])
        params[name]["bias"] = np.where(np.arange(len(params[name]["bias"])) == number, 50.0, 0.0).astype(np.float32)
    counting = model.with_component("count_predictor", config, params)
    made = draw(counting, Condition(prompt="a road"))
    assert (made.num_lanes, made.num_agents) == (7, 3)
    made = draw(counting, Condition(prompt="a road", num_agents=5))  # what is given wins
    assert (made.num_lanes, made.num_agents) == (7, 5)


def test_sharp_counts_keep_to_the_likely_numbers(model):
    config = CountPredictorConfig(text_width=WIDTH, domains=2, width=8, queries=1, heads=1, max_lanes=9, max_agents=5)
    params = count_predictor(config).init(jax.random.key(0))
    for name in ("lanes", "agents"):
        params[name]["kernel"] = np.zeros_like(params[name]["kernel"])
        params[name]["bias"] = np.full(len(params[name]["bias"]), -50.0, np.float32)
        params[name]["bias"][2:4] = 0.3, 0.0
    drawn = {}
    for sharpness in (1.0, 100.0):
        sharp = dataclasses.replace(config, sharpness=sharpness)
        counting = model.with_component("count_predictor", sharp, params)
        told = with_counts(jax.random.key(0), encode_prompts([Condition(prompt="a road")] * 30, model), model=counting)
        drawn[sharpness] = {cond.num_lanes for cond in told}
    assert drawn == {1.0: {2, 3}, 100.0: {2}}


def test_doubts_are_told():
    assert prompt_warnings(Condition(prompt="a road with five vehicles and two pedestrians", num_agents=4))
    assert not prompt_warnings(Condition(prompt="a road with five vehicles and two pedestrians", num_agents=8))
    assert not prompt_warnings(Condition(prompt="a four-way intersection", num_agents=1))
    assert not prompt_warnings(Condition(prompt="no cars")) and not prompt_warnings(Condition())
    (doubt,) = prompt_warnings(Condition(prompt="Kreuzung mit vier Autos und roter Ampel", num_agents=4))
    assert "read from 'Kreuzung mit vier" in doubt and "Plain English" in doubt


def test_kept_prompts_come_back(tmp_path):
    features = {"eine Straße, zwei Autos": np.ones((3, WIDTH), np.float32)}
    write_prompts(features, "words-1", tmp_path / "prompts.safetensors")
    back = load_prompts(tmp_path / "prompts.safetensors", "words-1")
    chex.assert_trees_all_equal(back, features)
    assert load_prompts(tmp_path / "prompts.safetensors", "words-2") == {}
    assert load_prompts(tmp_path / "nothing", "words-1") == {}


def test_a_scene_whose_ego_stands_on_no_lane_misses_more():
    on, off = chain(0.0), chain(0.0)
    off.agents[0, 1] = 10.0
    assert best("a road", [off, on]) == 1 and best("a road", [on, off]) == 0


def test_of_equals_the_one_whose_joints_are_closed_is_the_best():
    assert best("a road", [chain(1.2), chain(0.4), chain(0.9)]) == 1


def test_candidates_have_the_counts_that_a_draw_would_have():
    model = tiny_model()
    told = with_counts(jax.random.key(3), [Condition(), Condition(num_agents=2)], model=model)
    made = scjax.sample_many(jax.random.key(3), [Condition(), Condition(num_agents=2)], model=model, steps=2)
    assert [(one.num_agents, one.num_lanes) for one in told] == [(s.num_agents, s.num_lanes) for s in made]


def test_the_best_scene_shows_most_of_the_prompt_then_overlaps_least():
    few, many, crammed = queue(6.0, cars=3), queue(6.0, cars=6), queue(-1.0, cars=6)
    assert best("five vehicles", [few, crammed, many]) == 2
    assert best("two vehicles", [many, few]) == 1
    assert best("no such words", [many, many]) == 0
    with pytest.raises(ValueError, match="no scenes to choose from"):
        best("a road", [])
