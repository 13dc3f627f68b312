"""Prompts and what the parser reads from them; captions checked against their own scenes."""

from __future__ import annotations

import pytest

from scjax.language.captioner import STYLES, write_caption
from scjax.language.facts import extract_facts
from scjax.language.prompt_parser import PromptSpec, check, parse_prompt
from tests.factories.event_scenes import EVENT_SCENES
from tests.factories.road_scenes import ROAD_SCENES

PROMPTS = {
    "a busy four-way intersection with a red light, five vehicles and two pedestrians": PromptSpec(
        "four-way", (5, 5), True, (2, 2), None, "red"
    ),
    "The scene is a T-intersection. Multiple vehicles exist.": PromptSpec("T", (2, 12)),
    "ROAD & CONTROL: Straight road. AGENTS: No other vehicles are nearby.": PromptSpec("straight", (0, 0)),
    "a roundabout, 3 cyclists, no pedestrians": PromptSpec("roundabout", None, False, (0, 0), (3, 3)),
    "A wrong-way driver on a curved road": PromptSpec("curve", events=("wrong-way driver",)),
    "two vehicles ahead in the ego lane": PromptSpec(),
    "green traffic light, many cars": PromptSpec(None, (6, 60), signal="green"),
    "a straight road without any jaywalker, no red light": PromptSpec("straight"),
    "no wrong-way driver but a jaywalker and a red light": PromptSpec(signal="red", events=("jaywalker",)),
    "somewhere": PromptSpec(),
}


@pytest.mark.parametrize("text", list(PROMPTS))
def test_parse_prompt_reads_plain_statements(text):
    assert parse_prompt(text) == PROMPTS[text]


@pytest.mark.parametrize("style", STYLES)
def test_check_accepts_scene_of_its_own_caption(style):
    """The parser may read vague words differently from the captioner; everything else must fit."""
    num_checks = 0
    for builder, _ in [*ROAD_SCENES.values(), *EVENT_SCENES.values()]:
        facts = extract_facts(builder.scene())
        for seed in range(4):
            caption = write_caption(facts, seed, style)
            for name, result in check(parse_prompt(caption), facts).items():
                num_checks += 1
                assert result or name == "vehicles, vague", (caption, name, facts)
    assert num_checks > 60


@pytest.fixture(scope="module")
def one_vehicle_facts():
    """Facts of a scene with one vehicle besides the ego."""
    return extract_facts(EVENT_SCENES["wrong-way driver"][0].scene())


def test_check_tolerates_one_vehicle_more_or_less(one_vehicle_facts):
    assert check(PromptSpec(vehicles=(2, 2), exact=True), one_vehicle_facts) == {"vehicles, number": True}
    assert check(PromptSpec(vehicles=(3, 3), exact=True), one_vehicle_facts) == {"vehicles, number": False}


def test_check_reports_every_attribute_of_the_prompt(one_vehicle_facts):
    spec = PromptSpec(pedestrians=(0, 0), signal="red", events=("cut-in",))
    assert check(spec, one_vehicle_facts) == {"pedestrians": True, "signal": False, "event: cut-in": False}
