"""Retrieval baselines: what each rule finds, and tf-idf by hand."""

import dataclasses

import numpy as np
import pytest

from scjax.evaluate.requests import prompt_request
from scjax.evaluate.retrieval import RULES, Index, retrieve, tf_idf
from scjax.evaluate.sources import open_source
from tests.factories.evaluations import RoadModel


def index(counts, clusters, captions=()):
    return Index(np.array(counts), np.array(clusters), list(captions))


CANDIDATES = index(
    [(5, 5), (9, 9), (5, 6), (30, 30)],
    ["a", "b", "b", "c"],
    ["a quiet road", "a four-way intersection with cars", "a quiet road", "a wide road"],
)
QUERIES = index([(5, 5), (9, 8)], ["a", "c"], ["a quiet road", "a four-way intersection"])


@pytest.mark.parametrize("rule", ["count-matched", "nearest caption", "nearest caption + counts"])
def test_retrieve_finds_the_nearest_scene(rule):
    assert retrieve(rule, QUERIES, CANDIDATES).tolist() == [2, 1]


@pytest.mark.parametrize("rule", RULES)
def test_retrieve_avoids_the_own_location_and_repeats(rule):
    rows = retrieve(rule, QUERIES, CANDIDATES, seed=3)
    assert (CANDIDATES.clusters[rows] != QUERIES.clusters).all()
    np.testing.assert_array_equal(rows, retrieve(rule, QUERIES, CANDIDATES, seed=3))


def test_retrieve_needs_another_location():
    with pytest.raises(ValueError, match="name a larger retrieval set"):
        retrieve("chance", QUERIES, index([(1, 1)], ["a"]))


def test_retrieve_needs_captions():
    with pytest.raises(ValueError, match="captions=True"):
        retrieve("nearest caption", index([(1, 1)], ["a"]), CANDIDATES)


def test_retrieve_rejects_unknown_rules():
    with pytest.raises(ValueError, match="unknown baseline 'luck'"):
        retrieve("luck", QUERIES, CANDIDATES)


def test_retrieval_and_models_get_the_same_captions(worlds):
    source, model = open_source(f"npz:{worlds}"), dataclasses.replace(RoadModel().model, domains=("city",))
    conditions = [prompt_request(model, scene, "city") for scene in source.read(range(8))]
    prompts = [condition.prompt for condition in conditions]
    assert prompts == Index.of(source, captions=True).captions
    assert len(set(prompts)) > 1 and {condition.domain for condition in conditions} == {"city"}


def test_tf_idf_matches_hand_computed_values():
    candidates, texts = tf_idf(["a b", "a c"], ["a b", "d"])
    rare, common = np.log(3 / 2) + 1, 1.0  # "b" and "a b" are in one text, "a" in both
    norm = np.sqrt(common**2 + 2 * rare**2)
    np.testing.assert_allclose((candidates @ texts.T).toarray(), [[1, 0], [common**2 / norm**2, 0]])
