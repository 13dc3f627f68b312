"""Rare events in synthetic worlds, and whether the language rules find them."""

from __future__ import annotations

import collections

import pytest

from scjax.language.analysis.rare_events import EVENTS
from scjax.language.attributes.table import measure_attributes
from scjax.synthetic.events import EVENT_CLASSES
from scjax.synthetic.world import make_world
from tests.factories.synthetic_scenes import scenes_of


@pytest.fixture(scope="module")
def scene_events() -> list[tuple[str | None, set[str]]]:
    """The event that each scene shows, and those that the rules detect."""
    return [
        (ego.event, set(measure_attributes(scene)["event"]))
        for k in range(24)
        for ego, scene in scenes_of(make_world(11, k, event_share=1.0))
    ]


def test_event_classes_cover_all_events():
    assert set(EVENT_CLASSES) == set(EVENTS)


def test_worlds_show_most_events(scene_events):
    shown = collections.Counter(event for event, _ in scene_events if event is not None)
    assert len(shown) >= 5 and all(event in EVENTS for event in shown)


def test_rules_find_shown_events(scene_events):
    matches = [event in detected for event, detected in scene_events if event is not None]
    assert sum(matches) / len(matches) >= 0.9


def test_rules_find_vehicles_that_stop_in_a_lane():
    """A scene with the event holds the road ahead of the vehicle, where a cause could be."""
    detected = [
        "stopped-in-lane" in measure_attributes(scene)["event"]
        for k in range(12)
        for ego, scene in scenes_of(make_world(21, k, events=("stopped-in-lane",)))
        if ego.event == "stopped-in-lane"
    ]
    assert len(detected) > 15 and sum(detected) / len(detected) > 0.95


def test_worlds_without_events_show_few():
    """Some traffic stands for reasons that a scene does not show."""
    shown = [
        bool(measure_attributes(scene)["event"])
        for k in range(30)
        for _, scene in scenes_of(make_world(11, k, event_share=0.0))
    ]
    assert len(shown) > 60 and sum(shown) / len(shown) < 0.06
