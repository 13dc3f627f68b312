"""Each rare event in a scene drawn by hand, and similar scenes without it."""

from __future__ import annotations

import pytest

from scjax.language.captioner import STYLES, write_caption
from scjax.language.events import EVENTS
from scjax.language.facts import extract_facts
from tests.factories.event_scenes import EVENT_SCENES

CAPTION_WORDS = {
    "wrong-way driver": "wrong",
    "jaywalker": "cross",
    "stopped vehicle in lane": "lane",
    "double parking": "double",
    "emergency corridor": "emergency",
    "cut-in": "cut",
    "work zone": "work",
}


def test_event_scenes_cover_all_events():
    assert set(EVENT_SCENES) == set(EVENTS)


@pytest.mark.parametrize("event", EVENT_SCENES)
def test_find_events_detects_event(event):
    assert event in extract_facts(EVENT_SCENES[event][0].scene()).events


@pytest.mark.parametrize("event", EVENT_SCENES)
def test_find_events_ignores_similar_scenes(event):
    for builder in EVENT_SCENES[event][1]:
        assert event not in extract_facts(builder.scene()).events


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("event", EVENT_SCENES)
def test_captions_mention_events(event, style):
    facts = extract_facts(EVENT_SCENES[event][0].scene())
    captions = [write_caption(facts, seed, style, drop=0.0).lower() for seed in range(6)]
    assert all(CAPTION_WORDS[event] in caption for caption in captions), captions
