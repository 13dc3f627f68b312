"""What prompts ask for joins the attributes of their conditions."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
import pytest

from scjax.generate import readings
from scjax.generate.conditions import Condition, Stream
from scjax.generate.prompt_reader import PromptReader, reader_config
from scjax.generate.readings import prompt_warnings, read_prompts, reads_requests
from scjax.language.attributes.shown import shown_request
from scjax.language.reader.targets import Reading
from scjax.models.denoiser.config import TextCondition
from scjax.models.reader_network import reader_network
from tests.factories.words import Words
from tests.factories.worlds import tiny_model

REQUESTS = {
    "two cars at a T": {"layout": "T", "vehicles": (2, 2)},
    "nothing ahead but a jam": {"vehicles": (10, None), "ahead": (0, 0), "one_way": True, "lanes_opposite": (2, 2)},
    "purple": {},
}

LIKELY = {"two cars at a T": {"pedestrians": (1, None), "one_way": True, "slope": "up"}}


@pytest.fixture(scope="module")
def reader():
    """A reader that has read all texts of this file."""
    config = reader_config(8, width=16, heads=2)
    known = {
        text: Reading(request, dict.fromkeys(request, 0.9), LIKELY.get(text, {})) for text, request in REQUESTS.items()
    }
    return PromptReader(config, reader_network(config).init(jax.random.key(0)), "none", known)


@pytest.fixture(scope="module")
def model():
    return dataclasses.replace(tiny_model(TextCondition(Words.width)), text_encoder=Words.name, reads_prompts=True)


def test_prompts_become_attributes(model, reader):
    conditions = [Condition(prompt="two cars at a T", num_lanes=5), Condition(num_agents=3)]
    first, second = read_prompts(conditions, model, reader).conditions
    assert first == dataclasses.replace(conditions[0], attributes=REQUESTS["two cars at a T"])
    assert second == conditions[1]


def test_negative_prompts_become_negative_attributes(model, reader):
    condition = Condition(prompt="purple", negative_prompt="two cars at a T", negative_attributes={"layout": "Y"})
    (read,) = read_prompts([condition], model, reader).conditions
    assert read.attributes == {} and read.negative_attributes == {"layout": "Y", "vehicles": (2, 2)}


def test_given_attributes_win_over_read_ones(model, reader):
    condition = Condition(prompt="two cars at a T", attributes={"layout": "Y", "pedestrians": 1})
    (read,) = read_prompts([condition], model, reader).conditions
    assert read.attributes == {"layout": "Y", "vehicles": (2, 2), "pedestrians": (1, 1)}
    empty = Condition(prompt="two cars at a T", attributes={"vehicles": 0, "ahead": 0})
    assert read_prompts([empty], model, reader).conditions[0].attributes == {
        "layout": "T",
        "vehicles": (0, 0),
        "ahead": (0, 0),
    }


def test_what_a_prompt_may_ask_for_goes_with_what_is_asked(model, reader):
    conditions = [
        Condition(prompt="two cars at a T"),
        Condition(prompt="two cars at a T", attributes={"slope": "down"}, negative_attributes={"pedestrians": 3}),
        Condition(prompt="two cars at a T", attributes={"lanes_opposite": 2}),  # no one-way road
        Condition(prompt="purple"),
        Condition(),
    ]
    likely = read_prompts(conditions, model, reader).likely
    assert [sorted(one) for one in likely] == [
        ["one_way", "pedestrians", "slope"],
        ["one_way"],
        ["pedestrians", "slope"],
        [],
        [],
    ]


def test_of_a_contradiction_neither_part_is_taken(model, reader):
    (read,) = read_prompts([Condition(prompt="nothing ahead but a jam")], model, reader).conditions
    assert read.attributes == {"vehicles": (10, None), "ahead": (0, 0)}
    assert prompt_warnings(Condition(prompt="nothing ahead but a jam"), reader) == [
        "'nothing ahead but a jam' contradicts itself in one_way and lanes_opposite: neither is taken"
    ]


def test_networks_that_read_prompts_themselves_get_none(model, reader):
    plain = dataclasses.replace(model, reads_prompts=False)
    conditions = [Condition(prompt="two cars at a T")]
    assert not reads_requests(plain) and read_prompts(conditions, plain, reader) == (conditions, [[]], [{}])
    given = [Condition(streams={"text": Stream(np.zeros((1, Words.width), np.float32))})]
    assert read_prompts(given, model, reader) == (given, [[]], [{}])


def test_networks_that_read_attributes_alone_need_requests():
    network = tiny_model()
    config = dataclasses.replace(network.denoiser.config, attributes=("layout=T",))
    assert not reads_requests(network)
    assert reads_requests(network.with_component("denoiser", config, network.denoiser.params))


def test_warnings_name_what_will_not_come_true(reader):
    assert prompt_warnings(Condition(), reader) == [] == prompt_warnings(Condition(prompt="two cars at a T"), reader)
    (nothing,) = prompt_warnings(Condition(prompt="purple"), reader)
    assert nothing == "nothing that a scene can show is understood of 'purple'"
    (few,) = prompt_warnings(Condition(prompt="two cars at a T", num_agents=2), reader)
    assert "asks for 2 agents or more besides the ego, but the number of agents is given as 2" in few
    assert not prompt_warnings(Condition(prompt="two cars at a T", num_agents=3), reader)


def test_requests_are_shown_in_short():
    request = {"layout": "T", "vehicles": (3, 5), "ahead": (2, None), "median": False, "turn_lane": ("left", "right")}
    assert shown_request(request) == "layout T, vehicles 3 to 5, ahead 2 or more, median no, turn_lane left and right"


def test_the_reader_that_ships_is_used_by_default(model, reader, monkeypatch):
    monkeypatch.setattr(readings, "load_reader", lambda: reader)
    (read,) = read_prompts([Condition(prompt="purple")], model).conditions
    assert read == Condition(prompt="purple")
