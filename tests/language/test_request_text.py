"""Texts of requests: the rules that read prompts find in them what was requested."""

from __future__ import annotations

import pytest

from scjax.language.attributes.request_text import request_text
from scjax.language.prompt_parser import parse_prompt


@pytest.mark.parametrize("layout", ["straight", "four-way", "T", "roundabout"])
@pytest.mark.parametrize("signal", ["red", "green", "yellow"])
def test_prompt_rules_read_layout_and_signal(layout, signal):
    spec = parse_prompt(request_text({"layout": layout, "signal": signal}))
    assert (spec.layout, spec.signal) == (layout, signal)


@pytest.mark.parametrize("number", [0, 1, 2, 7, 12, 15])
@pytest.mark.parametrize("name", ["vehicles", "pedestrians", "cyclists"])
def test_prompt_rules_read_numbers(name, number):
    assert getattr(parse_prompt(request_text({name: number})), name) == (number, number)


@pytest.mark.parametrize(
    ("event", "name"),
    [("wrong-way", "wrong-way driver"), ("double-parking", "double parking"), ("jaywalker", "jaywalker")],
)
def test_prompt_rules_read_events(event, name):
    assert parse_prompt(request_text({"event": [event]})).events == (name,)


def test_text_is_whole_sentences():
    request = {"layout": "T", "lanes_same": 1, "lanes_opposite": 1, "vehicles": (3, 5), "ego": "stopped"}
    assert request_text(request) == (
        "A T-intersection with one lane in each direction and a few vehicles. The ego vehicle is stopped."
    ).replace("a few vehicles", "four vehicles")
    assert request_text({}) == "" == request_text({"layout": "unspecified"})
