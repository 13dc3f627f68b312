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
from scjax.generate.best_of import best_index, score_scene
from scjax.generate.conditions import Condition
from scjax.generate.counts import CountTables
from scjax.generate.requests import draw_request
from scjax.generate.sample import sample_requests, sampling_settings
from scjax.generate.scene_spec import specify_scene
from scjax.models.denoiser.config import TextCondition
from tests.factories.repair_scenes import chain, queue
from tests.factories.words import Words
from tests.factories.worlds import tiny_model

PROMPT = "a road with two cars"
REQUEST = {"vehicles": (2, 2)}


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
    request = draw_request(key, specify_scene(condition, streams, model), model, CountTables(model))
    options = sampling_settings(model, 2, None, None, None, None)
    return sample_requests(request.candidates(number), model, options)


def test_score_counts_an_ego_off_the_lanes():
    on, off = chain(0.0), chain(0.0)
    off.agents[0, 1] = 10.0
    road = {"vehicles": (0, None)}
    assert best_index([off, on], road) == 1 and best_index([on, off], road) == 0
    assert score_scene(off, road).missed == score_scene(on, road).missed + 1


def test_score_counts_loose_ends():
    whole, cut = chain(0.0, lanes=7), chain(0.0, lanes=7)
    for one in (whole, cut):
        one.lanes[..., 0] -= 32.0
        one.agents[0, 0] = -5.0
    cut.lane_mask[3] = False
    assert score_scene(cut, {}).faults == score_scene(whole, {}).faults + 2


def test_score_counts_vehicles_against_their_lane():
    along, against = chain(0.0), chain(0.0)
    against.agents[0, 4:6] *= -1
    assert score_scene(against, {}).faults == score_scene(along, {}).faults + 1
    assert best_index([against, along], {}) == 1


def test_score_prefers_smaller_gaps_of_equals():
    assert best_index([chain(1.2), chain(0.4), chain(0.9)], {}) == 1


def test_score_puts_the_request_before_faults():
    few, many, crammed = queue(6.0, cars=3), queue(6.0, cars=6), queue(-1.0, cars=6)
    assert best_index([few, crammed, many], {"vehicles": (5, 5)}) == 2
    assert best_index([many, few], {"vehicles": (2, 2)}) == 1


def test_score_without_a_request_counts_faults_only():
    few, crammed = queue(6.0, cars=3), queue(-1.0, cars=6)
    assert score_scene(few, {}).missed == score_scene(crammed, {}).missed == 0
    assert best_index([crammed, few], {}) == 1


def test_best_index_takes_the_first_of_equals():
    assert best_index([queue(6.0), queue(6.0)], {}) == 0
    with pytest.raises(ValueError, match="no scenes to choose from"):
        best_index([], {})


def test_best_of_one_equals_plain(model):
    condition = Condition(prompt=PROMPT, num_lanes=5)
    plain, one = sample(model, condition, num_scenes=2), sample(model, condition, num_scenes=2, best_of=1)
    chex.assert_trees_all_equal(plain.to_dict(), one.to_dict())


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000), number=st.integers(2, 6), request=st.sampled_from([{}, REQUEST]))
def test_best_of_returns_the_best_candidate_of_its_key(model, seed, number, request):
    condition = Condition(prompt=PROMPT, attributes=request)
    candidates = candidates_of(model, condition, number, seed)
    chosen = sample(model, [condition], seed, best_of=number)[0]
    equal = [
        all(np.array_equal(value, one.to_dict()[name]) for name, value in chosen.to_dict().items())
        for one in candidates
    ]
    assert any(equal)
    assert score_scene(chosen, request) == min(score_scene(one, request) for one in candidates)
    assert len({(int(one.num_lanes), int(one.num_agents), int(one.domain)) for one in candidates}) == 1
    assert len({one.lanes.tobytes() for one in candidates}) == number


def test_best_of_candidates_are_repaired_before_the_choice(model):
    condition = Condition(prompt=PROMPT, attributes=REQUEST, num_lanes=5, num_agents=4)
    repaired = [scjax.repair(one) for one in candidates_of(model, condition, 3)]
    chosen = sample(model, [condition], best_of=3, repair=True)[0]
    chex.assert_trees_all_equal(chosen.to_dict(), repaired[best_index(repaired, condition.attributes)].to_dict())


def test_best_of_below_one_is_refused(model):
    with pytest.raises(ValueError, match=r"best_of must be a whole number in 1\.\.100000, not 0"):
        sample(model, best_of=0)
