"""Each rare event on a hand-made scene, beside an ordinary scene that differs by little."""

from __future__ import annotations

import pytest

from scjax.language.captioner import write_caption
from scjax.language.facts import extract_facts
from scjax.scene import AgentType
from tests.factories.towns import WIDTH, Town


def two_way(**options) -> Town:
    town = Town()
    town.road(**{"same": 2, "opposite": 2, **options})
    return town


def corridor(outwards: float) -> Town:
    town = Town(speed=0.5)
    town.road(same=2, opposite=0)
    for x in (-14, 8, 16):
        town.agent(x, outwards, 0, 0.3)
        town.agent(x, -WIDTH - outwards, 0, 0.3)
    return town


SCENES = {
    "wrong-way driver": (
        two_way().agent(15, 0, 180, 9.0),
        [two_way().agent(15, WIDTH, 180, 9.0), two_way().agent(15, 0, 0, 9.0), two_way().agent(15, 0, 180, 0.0)],
    ),
    "jaywalker": (
        two_way().agent(14, 0.5, 90, 1.4, AgentType.PEDESTRIAN),
        [two_way().agent(14, -9.0, 90, 1.4, AgentType.PEDESTRIAN),
         two_way().agent(14, 0.5, 0, 1.4, AgentType.PEDESTRIAN),
         Town().crossing((20, 1.75), (0, 90, 180, 270)).agent(8.5, 0, 90, 1.4, AgentType.PEDESTRIAN)],
    ),
    "stopped vehicle in lane": (
        two_way().agent(12, 0, 0, 0.0),
        [two_way().agent(12, 0, 0, 0.0).agent(19, 0, 0, 0.0), two_way().agent(12, -WIDTH - 2.6, 0, 0.0),
         two_way().agent(12, 0, 0, 3.0), Town().crossing((20, 1.75), (0, 90, 180, 270)).agent(7, 0, 0, 0.0)],
    ),
    "double parking": (
        two_way().agent(12, -WIDTH - 0.8, 0, 0.0).agent(12.5, -WIDTH - 3.2, 0, 0.0),
        [two_way().agent(12, -WIDTH - 3.2, 0, 0.0).agent(18, -WIDTH - 3.2, 0, 0.0)],
    ),
    "emergency corridor": (corridor(0.8), [corridor(0.0), corridor(-0.5)]),
    "cut-in": (
        two_way().agent(10, -2.0, 6, 8.0),
        [two_way().agent(10, -WIDTH, 0, 8.0), two_way().agent(10, -2.0, 0, 8.0), two_way().agent(-12, -2.0, 6, 8.0)],
    ),
}  # fmt: skip


@pytest.mark.parametrize("event", list(SCENES))
def test_events_are_told_from_ordinary_scenes(event):
    town, ordinary = SCENES[event]
    assert event in extract_facts(town.scene()).events
    for other in ordinary:
        assert event not in extract_facts(other.scene()).events


@pytest.mark.parametrize("style", ["short", "heads", "long"])
@pytest.mark.parametrize("event", list(SCENES))
def test_events_are_said(event, style):
    facts = extract_facts(SCENES[event][0].scene())
    texts = [write_caption(facts, seed, style, drop=0.0).lower() for seed in range(6)]
    word = {"wrong-way driver": "wrong", "jaywalker": "cross", "stopped vehicle in lane": "lane",
            "double parking": "double", "emergency corridor": "emergency", "cut-in": "cut"}[event]  # fmt: skip
    assert all(word in text for text in texts), texts
