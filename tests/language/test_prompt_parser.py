from __future__ import annotations

import pytest

from scjax.language.captioner import STYLES, write_caption
from scjax.language.facts import extract_facts
from scjax.language.prompt_parser import PromptSpec, check, parse_prompt
from tests.language.test_events import SCENES
from tests.language.test_facts import GOLDEN

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
}  # fmt: skip


@pytest.mark.parametrize("text", list(PROMPTS))
def test_plain_statements_are_read(text):
    assert parse_prompt(text) == PROMPTS[text]


@pytest.mark.parametrize("style", STYLES)
def test_what_the_captioner_writes_is_met_by_its_own_scene(style):
    """Vague words may be read a little otherwise than they were meant; everything else must fit."""
    asked = 0
    for town in [town for town, _ in GOLDEN.values()] + [town for town, _ in SCENES.values()]:
        facts = extract_facts(town.scene())
        for seed in range(4):
            text = write_caption(facts, seed, style)
            for name, good in check(parse_prompt(text), facts).items():
                asked += 1
                assert good or name == "vehicles, vague", (text, name, facts)
    assert asked > 60


def test_numbers_may_be_off_by_one_or_a_fifth():
    facts = extract_facts(SCENES["wrong-way driver"][0].scene())  # one other vehicle
    assert check(PromptSpec(vehicles=(2, 2), exact=True), facts) == {"vehicles, number": True}
    assert check(PromptSpec(vehicles=(3, 3), exact=True), facts) == {"vehicles, number": False}
    assert check(PromptSpec(pedestrians=(0, 0), signal="red", events=("cut-in",)), facts) == {
        "pedestrians": True, "signal": False, "event: cut-in": False,
    }  # fmt: skip
