"""Attributes of a condition: what is checked, what they set, and that they choose among candidates."""

from __future__ import annotations

import pytest

from scjax.generate.best_of import best_index, score_scene
from scjax.generate.conditions import Condition
from scjax.generate.requests import _num_agents
from tests.factories.repair_scenes import queue


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


def test_attributes_give_the_text_where_there_is_no_prompt():
    attributes = {"layout": "T", "vehicles": 3}
    assert Condition(attributes=attributes).texts == {"text": "A T-intersection with three vehicles."}
    assert Condition(attributes=attributes, prompt="a road").texts == {"text": "a road"}
    assert Condition(attributes={"layout": "unspecified"}) == Condition()
    assert Condition().texts == {}


def test_attributes_set_the_number_of_agents_unless_it_is_given():
    attributes = {"vehicles": (3, 5), "pedestrians": 2, "cyclists": (1, None)}
    assert _num_agents(Condition(attributes=attributes), 0, 61) == 1 + 4 + 2 + 1
    assert _num_agents(Condition(attributes=attributes, num_agents=5), 0, 61) == 5
    assert _num_agents(Condition(attributes={"pedestrians": 2}), 0, 61) is None
    assert _num_agents(Condition(attributes={"vehicles": 90}), 0, 61) == 61
    assert _num_agents(Condition(attributes={"vehicles": 2}), 9, 61) == 9


def test_best_of_chooses_by_attributes():
    few, many = queue(6.0, cars=3), queue(6.0, cars=6)
    assert best_index(None, [few, many], {"vehicles": 5}) == 1
    assert best_index(None, [few, many], {"vehicles": 2}) == 0
    assert score_scene(None, few).missed == 0
    missed = score_scene(None, few, {"vehicles": 2}).missed  # the ego is on no lane
    assert score_scene(None, few, {"vehicles": 5}).missed == missed + 1
