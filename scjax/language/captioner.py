"""Facts -> a caption, in one of the three styles of the published prompts; the same seed gives the same words.

Facts are left out at random, numbers and vague words take turns, and what a scene lacks is sometimes said, because
people who write prompts do all three.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from scjax.language import wording
from scjax.language.facts import Facts

Style = Literal["short", "heads", "long"]
"""One or two short sentences; "ROAD & CONTROL: ... AGENTS: ..."; a paragraph."""
STYLES: tuple[Style, ...] = get_args(Style)


def write_caption(facts: Facts, seed: int, style: str | None = None, *, drop: float = 0.3) -> str:
    """A caption.

    Args:
      facts: of the scene.
      style: a ``Style``; None draws one.
      seed: of all choices of words.
      drop: probability with which a fact that may be left out is; the layout never is.

    Raises:
      ValueError: an unknown style, or a probability outside 0..1.
    """
    if style is not None and style not in STYLES:
        raise ValueError(f"unknown style {style!r}: choose one of {', '.join(STYLES)}")
    if not 0 <= drop <= 1:
        raise ValueError(f"drop is a probability, not {drop}")
    rng = np.random.default_rng(seed)
    chosen = style or STYLES[int(rng.integers(len(STYLES)))]
    words = {"short": _short, "heads": _heads, "long": _long}[chosen](facts, _Chance(rng, drop))
    return " ".join(part for part in words if part)


class _Chance:
    """The caption's random choices."""

    def __init__(self, rng: np.random.Generator, drop: float):
        self.rng, self._drop = rng, drop

    def keep(self, phrase: str | None) -> str | None:
        """The phrase, or None if it is left out."""
        return phrase if self.rng.random() >= self._drop else None


def _layout(facts: Facts, chance: _Chance) -> str:
    """The layout with lanes and curve, as a noun phrase."""
    noun = wording.pick_phrase(chance.rng, *wording.LAYOUTS[facts.layout])
    parts = [noun, chance.keep(wording.lane_phrase(facts, chance.rng))]
    phrase = " ".join(part for part in parts if part)
    bend = chance.keep(wording.curve_phrase(facts, chance.rng)) if facts.layout != "winding" else None
    return f"{phrase}, {bend}" if bend else phrase


def _short(facts: Facts, chance: _Chance) -> list[str]:
    verb = wording.pick_phrase(chance.rng, "is", "depicts", "shows")
    sentences = [f"The scene {verb} {_layout(facts, chance)}."]
    traffic, rng = facts.traffic, chance.rng
    who = [chance.keep(wording.count_phrase(traffic.vehicles, "vehicle", rng)) if traffic.vehicles else None]
    who += [chance.keep(wording.pedestrian_phrase(facts, rng))]
    who += [chance.keep(wording.count_phrase(traffic.cyclists, "cyclist", rng)) if traffic.cyclists else None]
    present = [phrase for phrase in who if phrase]
    if present:
        sentences.append(
            wording.pick_phrase(
                rng, f"There are {wording.join_phrases(present)}.", f"{_capital(wording.join_phrases(present))} exist."
            )
        )
    elif not traffic.vehicles and chance.keep("said"):
        sentences.append("There are no other vehicles.")
    sentences += _events(facts, rng)
    return [_grammar(sentence) for sentence in sentences]


def _heads(facts: Facts, chance: _Chance) -> list[str]:
    rng = chance.rng
    layout = wording.pick_phrase(rng, *wording.LAYOUTS[facts.layout])
    plain = facts.layout in ("straight", "curve", "winding")
    road = (
        _capital(wording.road_phrase(facts, rng))
        if plain
        else f"{_capital(wording.road_phrase(facts, rng))} at {layout}"
    )
    controls = [chance.keep(wording.turn_lane_phrase(facts, rng)), chance.keep(wording.signal_phrase(facts, rng))]
    controls += [chance.keep("separated by a median" if facts.median else None)]
    controls += [
        chance.keep(wording.curve_phrase(facts, rng)),
        chance.keep("a centre turn lane" if facts.centre_turn_lane else None),
    ]
    clauses = [road, *(clause for clause in controls if clause)]
    sentences = ["ROAD & CONTROL:", f"{', '.join(clauses)}."]
    absent = chance.keep(wording.absence_phrase(facts, rng))
    if absent:
        sentences.append(f"{_capital(absent)}.")
    return [_grammar(sentence) for sentence in [*sentences, "AGENTS:", *_agents(facts, chance)]]


def _long(facts: Facts, chance: _Chance) -> list[str]:
    rng = chance.rng
    sentences = [f"The scene {wording.pick_phrase(rng, 'depicts', 'shows', 'is')} {_layout(facts, chance)}."]
    sentences += [chance.keep(wording.intersection_sentence(facts, rng)) or ""]
    turns = chance.keep(wording.turn_lane_phrase(facts, rng))
    if turns:
        sentences.append(f"The ego vehicle's approach has {turns}.")
    if facts.median and chance.keep("said"):
        sentences.append("A median separates the two directions.")
    if facts.centre_turn_lane and chance.keep("said"):
        sentences.append("A centre turn lane runs between the directions.")
    streets = [(facts.side_streets_left, "left"), (facts.side_streets_right, "right")]
    for count, side in streets:
        if count and facts.layout == "several side streets":
            sentences.append(f"{_capital(wording.count_phrase(count, 'side street', rng))} on the {side}.")
    lights = chance.keep(wording.signal_phrase(facts, rng))
    if lights:
        sentences.append(f"There is {lights}.")
    if facts.bridge and chance.keep("said"):
        sentences.append("One road passes over another.")
    absent = chance.keep(wording.absence_phrase(facts, rng))
    if absent:
        sentences.append(f"There are {absent}.")
    return [_grammar(sentence) for sentence in [*sentences, *_agents(facts, chance)]]


def _agents(facts: Facts, chance: _Chance) -> list[str]:
    """Sentences about the ego and the others."""
    rng, traffic, sentences = chance.rng, facts.traffic, []
    motion = chance.keep(wording.motion_phrase(facts, rng))
    if motion:
        sentences.append(f"The ego vehicle {motion}.")
    if facts.ego_turn_lane and chance.keep("said"):
        sentences.append(f"The ego vehicle is in the {facts.ego_turn_lane}-turn lane.")
    elif facts.lanes_same > 1 and facts.lane_index and chance.keep("said"):
        sentences.append(f"The ego vehicle is in {_lane(facts)}.")
    near = [phrase for phrase in wording.relation_phrases(facts, rng) if chance.keep(phrase)]
    if near:
        sentences.append(f"{_capital(wording.join_phrases(near))}.")
    elif traffic.vehicles:
        sentences.append(f"{_capital(wording.count_phrase(traffic.vehicles, 'vehicle', rng))} on the road.")
    else:
        sentences.append("No other vehicles are nearby.")
    walkers = chance.keep(wording.pedestrian_phrase(facts, rng))
    if walkers:
        sentences.append(f"{_capital(walkers)}.")
    elif not traffic.pedestrians and rng.random() < 0.15:
        sentences.append("No pedestrians are visible.")
    if traffic.cyclists and chance.keep("said"):
        sentences.append(f"{_capital(wording.count_phrase(traffic.cyclists, 'cyclist', rng))}.")
    if traffic.static and chance.keep("said"):
        sentences.append(f"{_capital(wording.count_phrase(traffic.static, 'static object', rng))}.")
    return sentences + _events(facts, rng)


def _events(facts: Facts, rng: np.random.Generator) -> list[str]:
    found = wording.event_phrases(facts, rng)
    return [f"There is {wording.join_phrases(found)}."] if found else []


def _lane(facts: Facts) -> str:
    if facts.lane_index == 1:
        return "the left lane"
    return "the right lane" if facts.lane_index == facts.lanes_same else "a middle lane"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _grammar(sentence: str) -> str:
    """Singulars where a template was written for plurals."""
    single = ("one ", "a single ")
    for start in single:
        if sentence.startswith(f"There are {start}"):
            return sentence.replace("There are", "There is", 1)
        if sentence.startswith(_capital(start)) and sentence.endswith(" exist.") and " and " not in sentence:
            return f"{sentence[: -len(' exist.')]} exists."
    return sentence
