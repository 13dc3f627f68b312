"""Attributes of a condition: what is checked, what they set, and that they choose among candidates."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.generate.best_of import best_index, score_scene
from scjax.generate.conditions import Condition
from scjax.generate.counts import CountTables, usual_agents
from scjax.generate.encode import encode_conditions
from scjax.generate.scene_spec import specify_scene
from scjax.generate.text_streams import text_streams
from scjax.language.attributes.table import check_attributes
from scjax.models.denoiser.config import TextCondition
from tests.factories.repair_scenes import queue
from tests.factories.words import Words
from tests.factories.worlds import tiny_model


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({"layuot": "T"}, "Condition.attributes: there is no attribute 'layuot': write 'layout'"),
        ({"vehicles": "many"}, "Condition.attributes: vehicles is 'many': give a number"),
        ({"ego": "flying"}, "Condition.attributes: ego has no value 'flying'"),
        ([("layout", "T")], "Condition.attributes: attributes must map"),
    ],
)
def test_condition_refuses_faulty_attributes(attributes, message):
    with pytest.raises(ValueError, match=message):
        Condition(attributes=attributes)
    with pytest.raises(ValueError, match=message.replace("attributes:", "negative_attributes:", 1)):
        Condition(negative_attributes=attributes)


def test_attributes_give_the_text_of_a_model_that_reads_text_alone():
    """Instead of a prompt only where prompts become requests, and never instead of one that ships with its features."""
    attributes, text = {"layout": "T", "vehicles": 3}, "A T-intersection with three vehicles."
    model = dataclasses.replace(tiny_model(TextCondition(Words.width)), text_encoder=Words.name)

    def texts(model, **condition):
        encoder = Words()
        text_streams([Condition(**condition)], model, encoder)
        return encoder.calls

    assert texts(model, attributes=attributes) == [text]
    assert texts(model, attributes=attributes, prompt="a road") == ["a road"]
    reads = dataclasses.replace(model, reads_prompts=True)
    assert texts(reads, attributes=attributes, prompt="a road") == [text]
    assert texts(reads, prompt="a road") == ["a road"]
    stored = dataclasses.replace(reads, prompts={"a road": Words.features("a road")})
    assert texts(stored, attributes=attributes, prompt="a road") == []
    assert texts(model, negative_attributes=attributes, prompt="a road") == ["a road", text]
    assert Condition(attributes={"layout": "unspecified"}) == Condition()


def test_attributes_set_the_number_of_agents():
    attributes = check_attributes({"vehicles": (3, 5), "pedestrians": 2, "cyclists": (1, None)})
    assert usual_agents(attributes) == 1 + 4 + 2 + 1
    assert usual_agents(check_attributes({"pedestrians": 2})) is None


@pytest.mark.parametrize(
    ("attributes", "fields", "expected"),
    [
        ({"vehicles": (3, 5), "pedestrians": 2, "cyclists": (1, None)}, {}, 8),
        ({"vehicles": (3, 5)}, {"num_agents": 2}, 2),
        ({"vehicles": 90}, {}, 61),
        ({"vehicles": 2}, {"known": queue(6.0, cars=9)}, 9),
    ],
)
def test_numbers_of_agents_hold_those_that_are_given_or_known(attributes, fields, expected):
    model = tiny_model()
    spec = specify_scene(Condition(attributes=attributes, **fields), {}, model)
    assert CountTables(model).draw(np.random.default_rng(0), spec, None)[2] == expected


def test_best_of_chooses_by_attributes():
    few, many = queue(6.0, cars=3), queue(6.0, cars=6)
    assert best_index([few, many], {"vehicles": 5}) == 1
    assert best_index([few, many], {"vehicles": 2}) == 0
    assert score_scene(few, {}).missed == 0
    missed = score_scene(few, {"vehicles": 2}).missed  # the ego is on no lane
    assert score_scene(few, {"vehicles": 5}).missed == missed + 1


def test_attributes_are_no_text_for_a_model_without_text():
    assert encode_conditions([Condition(attributes={"vehicles": 3})], tiny_model()) == [{}]
