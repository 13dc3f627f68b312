"""The choice among candidates: what scores count, which candidate wins, and that candidates belong to their scene."""

from __future__ import annotations

import dataclasses

import chex
import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import scjax
from scjax.generate.best_of import best_index, prompt_warnings, score_scene
from scjax.generate.conditions import Condition
from scjax.generate.counts import CountTables
from scjax.generate.requests import draw_request
from scjax.generate.sample import _sample_latents_and_decode, _settings
from scjax.models.denoiser.config import TextCondition
from tests.factories.repair_scenes import chain, queue
from tests.factories.words import Words
from tests.factories.worlds import tiny_model

PROMPT = "a road with two cars"


@pytest.fixture(scope="module")
def model():
    prompts = {PROMPT: Words.features(PROMPT)}
    return dataclasses.replace(tiny_model(TextCondition(Words.width)), text_encoder=Words.name, prompts=prompts)


def sample(model, condition=None, seed=0, **options):
    return scjax.sample(jax.random.key(seed), condition, model=model, num_steps=2, **options)


def candidates_of(model, condition, number, seed=0):
    """The candidates of a call's first scene, sampled one stage below ``scjax.sample``."""
    key = jax.random.fold_in(jax.random.key(seed), 0)
    streams = {} if condition.prompt is None else {"text": scjax.Stream(model.prompts[condition.prompt])}
    request = draw_request(key, condition, streams, model, CountTables(model))
    options = _settings(model, 2, None, None, None, None)
    return _sample_latents_and_decode(request.candidates(number), model, options)


def test_score_counts_an_ego_off_the_lanes():
    on, off = chain(0.0), chain(0.0)
    off.agents[0, 1] = 10.0
    assert best_index("a road", [off, on]) == 1 and best_index("a road", [on, off]) == 0
    assert score_scene("a road", off).missed == score_scene("a road", on).missed + 1


def test_score_prefers_smaller_gaps_of_equals():
    assert best_index("a road", [chain(1.2), chain(0.4), chain(0.9)]) == 1


def test_score_puts_the_prompt_before_faults():
    few, many, crammed = queue(6.0, cars=3), queue(6.0, cars=6), queue(-1.0, cars=6)
    assert best_index("five vehicles", [few, crammed, many]) == 2
    assert best_index("two vehicles", [many, few]) == 1


def test_score_without_a_prompt_counts_faults_only():
    few, crammed = queue(6.0, cars=3), queue(-1.0, cars=6)
    assert score_scene(None, few).missed == score_scene(None, crammed).missed == 0
    assert best_index(None, [crammed, few]) == 1


def test_best_index_takes_the_first_of_equals():
    assert best_index("no such words", [queue(6.0), queue(6.0)]) == 0
    with pytest.raises(ValueError, match="no scenes to choose from"):
        best_index("a road", [])


def test_best_of_one_equals_plain(model):
    condition = Condition(prompt=PROMPT, num_lanes=5)
    plain, one = sample(model, condition, num_scenes=2), sample(model, condition, num_scenes=2, best_of=1)
    chex.assert_trees_all_equal(plain.to_dict(), one.to_dict())


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000), number=st.integers(2, 6), prompt=st.sampled_from([None, PROMPT]))
def test_best_of_returns_the_best_candidate_of_its_key(model, seed, number, prompt):
    condition = Condition(prompt=prompt)
    candidates = candidates_of(model, condition, number, seed)
    chosen = sample(model, [condition], seed, best_of=number)[0]
    equal = [
        all(np.array_equal(value, one.to_dict()[name]) for name, value in chosen.to_dict().items())
        for one in candidates
    ]
    assert any(equal)
    assert score_scene(prompt, chosen) == min(score_scene(prompt, one) for one in candidates)
    assert len({(int(one.num_lanes), int(one.num_agents), int(one.domain)) for one in candidates}) == 1
    assert len({one.lanes.tobytes() for one in candidates}) == number


def test_best_of_candidates_are_repaired_before_the_choice(model):
    condition = Condition(prompt=PROMPT, num_lanes=5, num_agents=4)
    repaired = [scjax.repair(one) for one in candidates_of(model, condition, 3)]
    chosen = sample(model, [condition], best_of=3, repair=True)[0]
    chex.assert_trees_all_equal(chosen.to_dict(), repaired[best_index(PROMPT, repaired)].to_dict())


def test_best_of_below_one_is_refused(model):
    with pytest.raises(ValueError, match=r"best_of must be a whole number in 1\.\.100000, not 0"):
        sample(model, best_of=0)


def test_prompt_warnings_name_too_few_agents():
    prompt = "a road with five vehicles and two pedestrians"
    assert prompt_warnings(Condition(prompt=prompt, num_agents=4))
    assert not prompt_warnings(Condition(prompt=prompt, num_agents=8))


def test_prompt_warnings_are_none_for_plain_prompts():
    assert not prompt_warnings(Condition(prompt="a four-way intersection", num_agents=1))
    assert not prompt_warnings(Condition(prompt="no cars")) and not prompt_warnings(Condition())


def test_prompt_warnings_name_prompts_that_no_rule_reads():
    (warning,) = prompt_warnings(Condition(prompt="Kreuzung mit vier Autos und roter Ampel", num_agents=4))
    assert "read from 'Kreuzung mit vier" in warning and "Plain English" in warning
