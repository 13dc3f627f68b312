"""Texts of requests say what was requested."""

from __future__ import annotations

import pytest

from scjax.language.attributes.request_text import request_text


@pytest.mark.parametrize("layout", ["straight", "four-way", "T", "roundabout"])
@pytest.mark.parametrize("signal", ["red", "green", "yellow"])
def test_layout_and_signal_are_named(layout, signal):
    text = request_text({"layout": layout, "signal": signal})
    assert layout in text and f"a {signal} traffic light" in text


@pytest.mark.parametrize(("number", "word"), [(0, "no"), (1, "one"), (2, "two"), (12, "twelve"), (15, "15")])
@pytest.mark.parametrize("name", ["vehicles", "pedestrians", "cyclists"])
def test_numbers_are_named(name, number, word):
    assert request_text({name: number}) == f"A road with {word} {name[:-1] if number == 1 else name}."


@pytest.mark.parametrize(
    ("event", "words"),
    [("wrong-way", "wrong-way driver"), ("double-parking", "double-parked"), ("jaywalker", "jaywalker")],
)
def test_events_are_named(event, words):
    assert words in request_text({"event": [event]})


def test_text_is_whole_sentences():
    request = {"layout": "T", "lanes_same": 1, "lanes_opposite": 1, "vehicles": (3, 5), "ego": "stopped"}
    assert request_text(request) == (
        "A T-intersection with one lane in each direction and a few vehicles. The ego vehicle is stopped."
    ).replace("a few vehicles", "four vehicles")
    assert request_text({}) == "" == request_text({"layout": "unspecified"})
