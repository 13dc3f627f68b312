"""Each rare event in a scene drawn by hand, and similar scenes without it."""

from __future__ import annotations

import pytest

from scjax.language.analysis.rare_events import EVENTS
from scjax.language.attributes.table import measure_attributes
from tests.factories.event_scenes import EVENT_SCENES


def test_event_scenes_cover_all_events():
    assert set(EVENT_SCENES) == set(EVENTS)


@pytest.mark.parametrize("event", EVENT_SCENES)
def test_find_events_detects_event(event):
    assert event in measure_attributes(EVENT_SCENES[event][0].scene())["event"]


@pytest.mark.parametrize("event", EVENT_SCENES)
def test_find_events_ignores_similar_scenes(event):
    for builder in EVENT_SCENES[event][1]:
        assert event not in measure_attributes(builder.scene())["event"]
