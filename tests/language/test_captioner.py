"""Captions: determined by the seed, three styles, true to the facts, in the words of the published prompts."""

import dataclasses
import json
import re

import pytest

from scjax.language.captioner import STYLES, write_caption
from scjax.language.facts import Facts, extract_facts
from scjax.language.traffic import Traffic
from tests.factories.road_scenes import ROAD_SCENES

BUSY = Facts(
    "four-way",
    curve="straight",
    lanes_same=2,
    lanes_opposite=2,
    lane_index=1,
    intersection="four-way",
    intersection_side="ahead",
    intersection_distance=20,
    turn_lanes=("left",),
    signals="red",
    traffic=Traffic(
        vehicles=5,
        pedestrians=2,
        cyclists=1,
        ahead=1,
        oncoming=2,
        pedestrians_right=2,
        pedestrians_near_road=2,
        ego_motion="slow",
    ),
)
EMPTY = Facts("straight", curve="straight", lanes_same=1, lanes_opposite=1, lane_index=1, traffic=Traffic())


@pytest.mark.parametrize("style", STYLES)
def test_write_caption_is_determined_by_the_seed(style):
    texts = [write_caption(BUSY, seed, style) for seed in range(40)]
    assert texts == [write_caption(BUSY, seed, style) for seed in range(40)]
    assert len(set(texts)) > 30


def test_write_caption_styles_have_their_form():
    for seed in range(60):
        short, heads, long = (write_caption(BUSY, seed, style) for style in STYLES)
        assert re.fullmatch(r"The scene (is|depicts|shows) [^.]+\.( [^.]+\.)?", short), short
        assert re.fullmatch(r"ROAD & CONTROL: .+\. AGENTS: .+\.", heads), heads
        assert long.startswith("The scene ") and len(long) > len("The scene is a crossroads."), long
    assert {write_caption(BUSY, seed).split()[0] for seed in range(30)} == {"The", "ROAD"}


def test_write_caption_mentions_all_facts_without_drop():
    for seed in range(40):
        text = write_caption(BUSY, seed, "long", drop=0.0)
        for pattern in (
            "four-way|crossroads|two roads",
            "two lanes in each|multiple lanes in each",
            "left-turn lane",
            "red (traffic )?light",
            "pedestrians",
            "slow|crawl",
            "oncoming|opposite direction",
            "cyclist",
            "ahead|20 m",
        ):
            assert re.search(pattern, text), (pattern, text)
    captions = [write_caption(BUSY, seed, "short", drop=0.0).lower() for seed in range(20)]
    assert any("two pedestrians" in caption for caption in captions)


def test_write_caption_uses_numbers_half_of_the_time():
    captions = [write_caption(BUSY, seed, "short", drop=0.0).lower() for seed in range(200)]
    share = sum("five vehicles" in caption for caption in captions) / 200
    assert 0.35 < share < 0.65


def test_write_caption_mentions_no_absent_facts():
    for seed in range(200):
        for style in STYLES:
            text = write_caption(EMPTY, seed, style).lower()
            assert not re.search(
                "pedestrians? (on|near)|oncoming|turn lane|light|median|cyclist|bridge|passes over", text
            )
            assert "no other vehicles" in text or style == "short", text
        caption = write_caption(BUSY, seed, "heads").lower()
        assert "no intersections" not in caption and "no other vehicles" not in caption


def test_write_caption_sometimes_states_absences():
    num_stated = sum("no intersections" in write_caption(EMPTY, seed, "heads").lower() for seed in range(200))
    assert 40 < num_stated < 180


def test_write_caption_uses_singular_for_one_vehicle():
    facts = dataclasses.replace(EMPTY, traffic=Traffic(vehicles=1))
    for seed in range(100):
        text = write_caption(facts, seed, "short", drop=0.0)
        assert not re.search(r"are (one|a single)|(One|A single) vehicle exist\b", text), text


def test_write_caption_has_phrases_for_every_layout():
    for builder, _ in ROAD_SCENES.values():
        facts = extract_facts(builder.scene())
        for style in STYLES:
            text = write_caption(facts, 1, style)
            assert "None" not in text and "  " not in text and text.endswith("."), text


def test_write_caption_uses_words_of_published_prompts(data_dir):
    """Every phrase of the published prompts that facts can express occurs in some of many captions."""
    path = data_dir / "peer_outputs" / "scenariocontrol_gallery" / "prompts.json"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    prompts = json.loads(path.read_text())
    published = [entry["prompt"] for kind in ("text_cond", "text_cond_extra") for entry in prompts[kind]]
    published += [entry["condition"] for entry in prompts["large_scene"] if entry["type"] == "text"]
    assert len(published) == 15
    variants = [BUSY, EMPTY, *(extract_facts(builder.scene()) for builder, _ in ROAD_SCENES.values())]
    captions = " ".join(write_caption(facts, seed) for facts in variants for seed in range(60)).lower()
    for phrase in (
        "four-way intersection",
        "multiple lanes in each direction",
        "t-intersection",
        "multiple vehicles",
        "multi-lane road",
        "narrow",
        "complex road topology",
        "curved layout",
        "pedestrian",
        "near the road",
        "road & control",
        "agents",
        "right-turn lane",
        "left-turn lane",
        "separated by a median",
        "in a single direction",
        "a few vehicles",
        "several vehicles",
        "one-way",
        "approaching from the opposite direction",
        "left lane",
        "no intersections",
    ):
        in_prompts = any(word in " ".join(published).lower() for word in (phrase, phrase.split()[0]))
        assert phrase in captions and in_prompts, phrase


def test_write_caption_rejects_bad_arguments():
    with pytest.raises(ValueError, match="unknown style 'poem': choose one of short, heads, long"):
        write_caption(BUSY, 0, "poem")
    with pytest.raises(ValueError, match="drop is a probability"):
        write_caption(BUSY, 0, drop=2.0)
