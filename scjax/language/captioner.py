"""Captions from facts, in the three styles of the published prompts; the same seed gives the same words.

As in prompts by people, captions leave out facts at random, mix numbers with vague words, and sometimes say what a
scene lacks.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from scjax.language import wording
from scjax.language.facts import Facts

CaptionStyle = Literal["short", "heads", "long"]
"""short: one or two sentences; heads: "ROAD & CONTROL: ... AGENTS: ..."; long: a paragraph."""
STYLES: tuple[CaptionStyle, ...] = get_args(CaptionStyle)


def write_caption(facts: Facts, seed: int, style: str | None = None, *, drop: float = 0.3) -> str:
    """A caption for one scene.

    Args:
      facts: facts of the scene.
      seed: seed of all random choices.
      style: one of ``STYLES``; None draws one.
      drop: probability of leaving out an optional fact; layout and events are always mentioned.

    Raises:
      ValueError: an unknown style, or a probability outside 0..1.
    """
    if style is not None and style not in STYLES:
        raise ValueError(f"unknown style {style!r}: choose one of {', '.join(STYLES)}")
    if not 0 <= drop <= 1:
        raise ValueError(f"drop is a probability, not {drop}")
    rng = np.random.default_rng(seed)
    style = style or STYLES[int(rng.integers(len(STYLES)))]
    compose = {"short": _short_sentences, "heads": _sentences_with_heads, "long": _long_sentences}[style]
    return " ".join(sentence for sentence in compose(facts, _Choices(rng, drop)) if sentence)


class _Choices:
    """Random choices of one caption: ``rng`` for words, ``keep`` for optional facts."""

    def __init__(self, rng: np.random.Generator, drop: float):
        self.rng, self._drop = rng, drop

    def include(self) -> bool:
        """Whether to mention an optional fact: False with probability ``drop``."""
        return bool(self.rng.random() >= self._drop)

    def keep(self, phrase: str | None) -> str | None:
        """The phrase, or None with probability ``drop``."""
        return phrase if self.include() else None


def _layout_phrase(facts: Facts, choices: _Choices) -> str:
    """Layout, lanes and curve as a noun phrase."""
    noun = wording.pick_phrase(choices.rng, *wording.LAYOUTS[facts.layout])
    parts = [noun, choices.keep(wording.lane_phrase(facts, choices.rng))]
    phrase = " ".join(part for part in parts if part)
    curve = choices.keep(wording.curve_phrase(facts, choices.rng)) if facts.layout != "winding" else None
    return f"{phrase}, {curve}" if curve else phrase


def _short_sentences(facts: Facts, choices: _Choices) -> list[str]:
    verb = wording.pick_phrase(choices.rng, "is", "depicts", "shows")
    sentences = [f"The scene {verb} {_layout_phrase(facts, choices)}."]
    traffic, rng = facts.traffic, choices.rng
    agents = [choices.keep(wording.count_phrase(traffic.vehicles, "vehicle", rng)) if traffic.vehicles else None]
    agents += [choices.keep(wording.pedestrian_phrase(facts, rng))]
    agents += [choices.keep(wording.count_phrase(traffic.cyclists, "cyclist", rng)) if traffic.cyclists else None]
    present = [phrase for phrase in agents if phrase]
    if present:
        sentences.append(
            wording.pick_phrase(
                rng,
                f"There are {wording.join_phrases(present)}.",
                f"{_capitalize(wording.join_phrases(present))} exist.",
            )
        )
    elif not traffic.vehicles and choices.include():
        sentences.append("There are no other vehicles." if facts.has_ego else "There are no vehicles.")
    sentences += _event_sentences(facts, rng)
    return [_fix_number(sentence) for sentence in sentences]


def _sentences_with_heads(facts: Facts, choices: _Choices) -> list[str]:
    rng = choices.rng
    layout = wording.pick_phrase(rng, *wording.LAYOUTS[facts.layout])
    is_plain = facts.layout in ("straight", "curve", "winding")
    road = _capitalize(wording.road_phrase(facts, rng))
    controls = [
        choices.keep(wording.turn_lane_phrase(facts, rng)),
        choices.keep(wording.signal_phrase(facts, rng)),
        choices.keep("separated by a median" if facts.median else None),
        choices.keep(wording.curve_phrase(facts, rng)),
        choices.keep("a centre turn lane" if facts.centre_turn_lane else None),
    ]
    clauses = [road if is_plain else f"{road} at {layout}", *(clause for clause in controls if clause)]
    sentences = ["ROAD & CONTROL:", f"{', '.join(clauses)}."]
    absent = choices.keep(wording.absence_phrase(facts, rng))
    if absent:
        sentences.append(f"{_capitalize(absent)}.")
    return [_fix_number(sentence) for sentence in [*sentences, "AGENTS:", *_agent_sentences(facts, choices)]]


def _long_sentences(facts: Facts, choices: _Choices) -> list[str]:
    rng = choices.rng
    sentences = [f"The scene {wording.pick_phrase(rng, 'depicts', 'shows', 'is')} {_layout_phrase(facts, choices)}."]
    sentences += [choices.keep(wording.intersection_sentence(facts, rng)) or ""]
    turns = choices.keep(wording.turn_lane_phrase(facts, rng))
    if turns:
        sentences.append(f"The ego vehicle's approach has {turns}.")
    if facts.median and choices.include():
        sentences.append("A median separates the two directions.")
    if facts.centre_turn_lane and choices.include():
        sentences.append("A centre turn lane runs between the directions.")
    streets = [(facts.side_streets_left, "left"), (facts.side_streets_right, "right")]
    for count, side in streets:
        if count and facts.layout == "several side streets":
            sentences.append(f"{_capitalize(wording.count_phrase(count, 'side street', rng))} on the {side}.")
    lights = choices.keep(wording.signal_phrase(facts, rng))
    if lights:
        sentences.append(f"There is {lights}.")
    if facts.bridge and choices.include():
        sentences.append("One road passes over another.")
    absent = choices.keep(wording.absence_phrase(facts, rng))
    if absent:
        sentences.append(f"There are {absent}.")
    return [_fix_number(sentence) for sentence in [*sentences, *_agent_sentences(facts, choices)]]


def _agent_sentences(facts: Facts, choices: _Choices) -> list[str]:
    """Sentences about the ego and the other agents."""
    rng, traffic, sentences = choices.rng, facts.traffic, []
    motion = choices.keep(wording.motion_phrase(facts, rng))
    if motion:
        sentences.append(f"The ego vehicle {motion}.")
    if facts.ego_turn_lane and choices.include():
        sentences.append(f"The ego vehicle is in the {facts.ego_turn_lane}-turn lane.")
    elif facts.lanes_same > 1 and facts.lane_index and choices.include():
        sentences.append(f"The ego vehicle is in {_lane_name(facts)}.")
    neighbors = [phrase for phrase in wording.relation_phrases(facts, rng) if choices.keep(phrase)]
    if neighbors:
        sentences.append(f"{_capitalize(wording.join_phrases(neighbors))}.")
    elif traffic.vehicles:
        sentences.append(f"{_capitalize(wording.count_phrase(traffic.vehicles, 'vehicle', rng))} on the road.")
    else:
        sentences.append("No other vehicles are nearby." if facts.has_ego else "There is no ego vehicle.")
    pedestrians = choices.keep(wording.pedestrian_phrase(facts, rng))
    if pedestrians:
        sentences.append(f"{_capitalize(pedestrians)}.")
    elif not traffic.pedestrians and rng.random() < 0.15:
        sentences.append("No pedestrians are visible.")
    if traffic.cyclists and choices.include():
        sentences.append(f"{_capitalize(wording.count_phrase(traffic.cyclists, 'cyclist', rng))}.")
    if traffic.static and choices.include():
        sentences.append(f"{_capitalize(wording.count_phrase(traffic.static, 'static object', rng))}.")
    return sentences + _event_sentences(facts, rng)


def _event_sentences(facts: Facts, rng: np.random.Generator) -> list[str]:
    phrases = wording.event_phrases(facts, rng)
    return [f"There is {wording.join_phrases(phrases)}."] if phrases else []


def _lane_name(facts: Facts) -> str:
    if facts.lane_index == 1:
        return "the left lane"
    return "the right lane" if facts.lane_index == facts.lanes_same else "a middle lane"


def _capitalize(text: str) -> str:
    return text[:1].upper() + text[1:]


def _fix_number(sentence: str) -> str:
    """The sentence in the singular, where a template in the plural has one subject."""
    for start in ("one ", "a single "):
        if sentence.startswith(f"There are {start}"):
            return sentence.replace("There are", "There is", 1)
        if sentence.startswith(_capitalize(start)) and sentence.endswith(" exist.") and " and " not in sentence:
            return f"{sentence[: -len(' exist.')]} exists."
    return sentence
