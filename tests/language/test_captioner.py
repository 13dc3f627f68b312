"""Sentences: the same seed the same words, three styles, nothing said that is not a fact, the published vocabulary."""

import dataclasses
import json
import re

import pytest

from scjax.language.captioner import STYLES, write_caption
from scjax.language.facts import Facts, extract_facts
from scjax.language.traffic import Traffic
from tests.language.test_facts import GOLDEN

BUSY = Facts(
    "four-way", curve="straight", lanes_same=2, lanes_opposite=2, lane_index=1, intersection="four-way",
    intersection_side="ahead", intersection_distance=20, turn_lanes=("left",), signals="red",
    traffic=Traffic(vehicles=5, pedestrians=2, cyclists=1, ahead=1, oncoming=2, pedestrians_right=2,
                    pedestrians_near_road=2, ego_motion="slow"),
)  # fmt: skip
EMPTY = Facts("straight", curve="straight", lanes_same=1, lanes_opposite=1, lane_index=1, traffic=Traffic())


@pytest.mark.parametrize("style", STYLES)
def test_a_seed_decides_every_word(style):
    texts = [write_caption(BUSY, seed, style) for seed in range(40)]
    assert texts == [write_caption(BUSY, seed, style) for seed in range(40)]
    assert len(set(texts)) > 30


def test_styles_have_their_forms():
    for seed in range(60):
        short, heads, long = (write_caption(BUSY, seed, style) for style in STYLES)
        assert re.fullmatch(r"The scene (is|depicts|shows) [^.]+\.( [^.]+\.)?", short), short
        assert re.fullmatch(r"ROAD & CONTROL: .+\. AGENTS: .+\.", heads), heads
        assert long.startswith("The scene ") and len(long) > len("The scene is a crossroads."), long
    assert {write_caption(BUSY, seed).split()[0] for seed in range(30)} == {"The", "ROAD"}


def test_everything_is_said_when_nothing_is_dropped():
    for seed in range(40):
        text = write_caption(BUSY, seed, "long", drop=0.0)
        for pattern in ("four-way|crossroads|two roads", "two lanes in each|multiple lanes in each", "left-turn lane",
                        "red (traffic )?light", "pedestrians", "slow|crawl", "oncoming|opposite direction", "cyclist",
                        "ahead|20 m"):  # fmt: skip
            assert re.search(pattern, text), (pattern, text)
    assert any("two pedestrians" in write_caption(BUSY, seed, "short", drop=0.0).lower() for seed in range(20))
    vague = [write_caption(BUSY, seed, "short", drop=0.0).lower() for seed in range(200)]
    share = sum("five vehicles" in text for text in vague) / 200
    assert 0.35 < share < 0.65


def test_nothing_is_said_that_is_not_so():
    for seed in range(200):
        for style in STYLES:
            text = write_caption(EMPTY, seed, style).lower()
            assert not re.search(
                "pedestrians? (on|near)|oncoming|turn lane|light|median|cyclist|bridge|passes over", text
            )
            assert "no other vehicles" in text or style == "short", text
        crowd = write_caption(BUSY, seed, "heads").lower()
        assert "no intersections" not in crowd and "no other vehicles" not in crowd


def test_absences_are_stated_at_times():
    said = sum("no intersections" in write_caption(EMPTY, seed, "heads").lower() for seed in range(200))
    assert 40 < said < 180


def test_one_thing_is_singular():
    one = dataclasses.replace(EMPTY, traffic=Traffic(vehicles=1))
    for seed in range(100):
        text = write_caption(one, seed, "short", drop=0.0)
        assert not re.search(r"are (one|a single)|(One|A single) vehicle exist\b", text), text


def test_every_layout_has_words():
    for town, _ in GOLDEN.values():
        facts = extract_facts(town.scene())
        for style in STYLES:
            text = write_caption(facts, 1, style)
            assert "None" not in text and "  " not in text and text.endswith("."), text


def test_the_published_prompts_use_words_that_occur(data_dir):
    """What can be read off a scene, the captioner says in the prompts' own words, at least once in many texts."""
    path = data_dir / "peer_outputs" / "scenariocontrol_gallery" / "prompts.json"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    prompts = json.loads(path.read_text())
    published = [entry["prompt"] for kind in ("text_cond", "text_cond_extra") for entry in prompts[kind]]
    published += [entry["condition"] for entry in prompts["large_scene"] if entry["type"] == "text"]
    assert len(published) == 15
    variants = [BUSY, EMPTY, *(extract_facts(town.scene()) for town, _ in GOLDEN.values())]
    said = " ".join(write_caption(facts, seed) for facts in variants for seed in range(60)).lower()
    for phrase in ("four-way intersection", "multiple lanes in each direction", "t-intersection", "multiple vehicles",
                   "multi-lane road", "narrow", "complex road topology", "curved layout", "pedestrian", "near the road",
                   "road & control", "agents", "right-turn lane", "left-turn lane", "separated by a median",
                   "in a single direction", "a few vehicles", "several vehicles", "one-way",
                   "approaching from the opposite direction", "left lane", "no intersections"):  # fmt: skip
        in_prompts = any(word in " ".join(published).lower() for word in (phrase, phrase.split()[0]))
        assert phrase in said and in_prompts, phrase


def test_mistakes_are_named():
    with pytest.raises(ValueError, match="unknown style 'poem': choose one of short, heads, long"):
        write_caption(BUSY, 0, "poem")
    with pytest.raises(ValueError, match="drop is a probability"):
        write_caption(BUSY, 0, drop=2.0)
