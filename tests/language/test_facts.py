"""Facts of scenes drawn by hand, their invariances and their JSON form."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from scjax.language.facts import FORMAT, Facts, extract_facts
from scjax.scene import pad, permute
from tests.factories.road_scenes import ROAD_SCENES


@pytest.mark.parametrize("name", ROAD_SCENES)
def test_extract_facts_golden_road_scenes(name):
    builder, expected = ROAD_SCENES[name]
    facts = extract_facts(builder.scene())
    assert {key: getattr(facts, key) for key in expected} == expected


def test_road_scenes_are_at_least_thirty():
    assert len(ROAD_SCENES) >= 30


@pytest.mark.parametrize("name", ["crossroads ahead", "left-turn lane", "lane added", "uneven", "roundabout"])
def test_extract_facts_ignores_order_and_padding(name):
    scene = copy.deepcopy(ROAD_SCENES[name][0]).add_agent(12, 1).add_agent(-9, 3, 180).scene()
    rng = np.random.default_rng(0)
    for _ in range(3):
        order = np.concatenate([[0], 1 + rng.permutation(len(scene.agents) - 1)])
        shuffled = permute(scene, order, rng.permutation(len(scene.lanes)))
        assert extract_facts(pad(shuffled, 20, 70)) == extract_facts(scene)


def test_facts_json_round_trip():
    for builder, _ in ROAD_SCENES.values():
        facts = extract_facts(builder.scene())
        assert Facts.from_json(json.loads(json.dumps(facts.to_json()))) == facts


def test_facts_from_json_rejects_other_formats():
    with pytest.raises(ValueError, match="format 7"):
        Facts.from_json({"format": 7})


def test_facts_from_json_rejects_unknown_fields():
    with pytest.raises(ValueError, match="unknown fields: colour"):
        Facts.from_json({"format": FORMAT, "layout": "T", "colour": "red"})
