"""Phrases for facts: each function knows several phrases for one fact and picks one at random."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.language.events import RULES
from scjax.language.facts import Facts

NUMBER_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_PLURALS = {"person": "people"}

LAYOUTS: dict[str, tuple[str, ...]] = {
    "straight": ("a straight road", "a road that runs straight on", "a straight stretch of road"),
    "curve": ("a curved road", "a road in a bend", "a road with a curved layout"),
    "winding": ("a winding road", "a road that bends one way and then the other"),
    "four-way": ("a four-way intersection", "a crossroads", "an intersection of two roads"),
    "T": ("a T-intersection", "a T-junction", "a three-way intersection"),
    "complex": ("an intersection with a complex road topology", "a complex intersection", "a complex junction"),
    "roundabout": ("a roundabout", "a traffic circle"),
    "parking area": ("a parking area", "the aisles of a parking lot"),
    "intersection at the edge": (
        "a road with an intersection at the edge of view",
        "a road that nears an intersection",
    ),
    "side road": ("a road with a side road", "a road from which a smaller road branches off"),
    "several side streets": ("a road with several side streets", "a road with a number of side streets"),
    "lane added": ("a road that gains a lane", "a road where a lane is added"),
    "lane ends": ("a road where lanes merge", "a road that loses a lane"),
    "split": ("a road that splits", "a fork in the road"),
    "merge": ("a merge of two roads", "a road into which another merges"),
    "junction at the edge": ("a road with a junction at the edge of view", "a road with a junction further off"),
    "no road": ("an open area without marked lanes", "an area without lanes"),
}


def number_word(count: int) -> str:
    """The number as a word up to twelve, in digits above."""
    return NUMBER_WORDS[count] if count < len(NUMBER_WORDS) else str(count)


def count_phrase(count: int, noun: str, rng: np.random.Generator) -> str:
    """``count`` things, as a number or in vague words ("several"), each with probability 1/2."""
    plural = _PLURALS.get(noun, f"{noun}s")
    if count == 0:
        return f"no {plural}"
    if count == 1:
        return pick_phrase(rng, f"one {noun}", f"a single {noun}")
    if rng.random() < 0.5:
        return f"{number_word(count)} {plural}"
    if count <= 3:
        return pick_phrase(rng, f"a few {plural}", f"a couple of {plural}" if count == 2 else f"some {plural}")
    return (
        pick_phrase(rng, f"several {plural}", f"multiple {plural}")
        if count <= 7
        else pick_phrase(rng, f"many {plural}", f"{plural} in numbers")
    )


def lane_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """Lanes of the ego's road, as an attribute of a noun ("with ..."); None off the road."""
    same, opposite = facts.lanes_same, facts.lanes_opposite
    if not same:
        return None
    if not opposite:
        if same == 1:
            return pick_phrase(rng, "with one lane in a single direction", "with a single one-way lane")
        return pick_phrase(
            rng, f"with {number_word(same)} lanes in a single direction", f"with {number_word(same)} one-way lanes"
        )
    if same == opposite == 1:
        return pick_phrase(rng, "with one lane in each direction", "with a lane for each direction")
    if min(same, opposite) >= 2:
        exact = f"with {number_word(same)} lanes in each direction" if same == opposite else None
        vague = "with multiple lanes in each direction"
        return (
            pick_phrase(rng, exact, vague) if exact else pick_phrase(rng, vague, _lanes_per_direction(same, opposite))
        )
    return _lanes_per_direction(same, opposite)


def road_phrase(facts: Facts, rng: np.random.Generator) -> str:
    """The ego's road as a noun."""
    total = facts.lanes_same + facts.lanes_opposite
    if not facts.lanes_same:
        return "road"
    if not facts.lanes_opposite and facts.lanes_same > 1:
        return f"{number_word(facts.lanes_same)}-lane one-way road"
    if total <= 2:
        return pick_phrase(rng, "narrow road", "two-lane road" if total == 2 else "single-lane road")
    return pick_phrase(rng, "multi-lane road", f"{number_word(total)}-lane road")


def curve_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """The curve of the ego's road as a clause; None where it runs straight."""
    if facts.curve in (None, "straight"):
        return None
    if facts.curve == "winding":
        return "winding"
    degree, _, side = (facts.curve or "").rpartition(" ")
    return pick_phrase(rng, f"curving {degree} to the {side}", f"bending {degree} {side}").replace("  ", " ")


def intersection_sentence(facts: Facts, rng: np.random.Generator) -> str | None:
    """Where the intersection lies, as a sentence."""
    side, distance = facts.intersection_side, facts.intersection_distance
    if facts.intersection is None or side is None:
        return None
    if side == "inside":
        return pick_phrase(
            rng, "The ego vehicle is inside the intersection.", "The ego vehicle stands in the intersection."
        )
    direction = {"ahead": "ahead", "behind": "behind the ego vehicle"}.get(side, f"to the {side}")
    if distance and rng.random() < 0.5:
        return f"The intersection is about {distance} m {direction}."
    return f"The intersection is {direction}."


def turn_lane_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """Dedicated turn lanes, as a noun phrase."""
    if not facts.turn_lanes:
        return None
    if len(facts.turn_lanes) == 2:
        return "dedicated left-turn and right-turn lanes"
    return f"a {pick_phrase(rng, 'dedicated ', '')}{facts.turn_lanes[0]}-turn lane"


def signal_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """State of the signal ahead, as a noun phrase; None where none is recorded."""
    if facts.signals is None:
        return None
    if facts.signals == "other":
        return pick_phrase(rng, "traffic lights", "signals at the intersection")
    return pick_phrase(rng, f"a {facts.signals} light for the ego vehicle", f"a {facts.signals} traffic light ahead")


def absence_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """What a plain road lacks, as a noun phrase; None where the road has a junction, a fork or a merge."""
    if facts.layout not in ("straight", "curve", "winding"):
        return None
    nouns = ["intersections", "merges", "splits"]
    chosen = [noun for noun in nouns if rng.random() < 0.7] or nouns[:1]
    return f"no {join_phrases(chosen, 'or')}"


def motion_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """How the ego moves, as a predicate; None where its speed is unknown."""
    phrases = {
        "stopped": ("is stopped", "stands still"),
        "slow": ("is moving slowly", "crawls along"),
        "moderate": ("is moving at moderate speed", "drives at a moderate speed"),
        "fast": ("is moving fast", "drives fast"),
    }
    choices = phrases.get(facts.traffic.ego_motion or "")
    return pick_phrase(rng, *choices) if choices else None


def relation_phrases(facts: Facts, rng: np.random.Generator) -> list[str]:
    """Vehicles by their relation to the ego, as noun phrases."""
    traffic = facts.traffic
    relations = (
        (traffic.ahead, ("ahead in the ego lane", "in front of the ego vehicle")),
        (traffic.behind, ("behind the ego vehicle", "following the ego vehicle")),
        (traffic.left_lane, ("in the lane to the left", "in the left neighbouring lane")),
        (traffic.right_lane, ("in the lane to the right", "in the right neighbouring lane")),
        (traffic.oncoming, ("oncoming", "approaching from the opposite direction")),
        (traffic.crossing, ("on the crossing road", "crossing the ego's way")),
        (traffic.turning, ("turning", "in a turn")),
        (traffic.parked, ("parked beside the road", "parked off the lanes")),
    )
    return [
        f"{count_phrase(count, 'vehicle', rng)} {pick_phrase(rng, *phrases)}" for count, phrases in relations if count
    ]


def pedestrian_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """Pedestrians and their common position, as a noun phrase; None without pedestrians."""
    traffic = facts.traffic
    if not traffic.pedestrians:
        return None
    phrase = count_phrase(traffic.pedestrians, "pedestrian", rng)
    places = []
    if traffic.pedestrians_left == traffic.pedestrians:
        places.append("on the left")
    elif traffic.pedestrians_right == traffic.pedestrians:
        places.append("on the right")
    if traffic.pedestrians_near_road == traffic.pedestrians:
        places.append("near the road")
    return f"{phrase} {pick_phrase(rng, *places)}" if places else phrase


def event_phrases(facts: Facts, rng: np.random.Generator) -> list[str]:
    """Rare events as noun phrases."""
    phrases = {rule.event: rule.phrases for rule in RULES}
    return [pick_phrase(rng, *phrases[event]) for event in facts.events]


def pick_phrase(rng: np.random.Generator, *choices: str) -> str:
    """One of ``choices``, drawn from ``rng``."""
    return choices[int(rng.integers(len(choices)))]


def join_phrases(parts: Sequence[str], last: str = "and") -> str:
    """``parts`` as an enumeration: "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"


def _lanes_per_direction(same: int, opposite: int) -> str:
    def phrase(count: int) -> str:
        return f"{number_word(count)} lane{'s' if count > 1 else ''}"

    return f"with {phrase(same)} in the ego's direction and {phrase(opposite)} in the other"
