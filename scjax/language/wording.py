"""Words for facts: every function offers several ways of saying one thing, of which the caller draws one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.language.facts import Facts

_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
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
        "a road with an intersection at the edge of view", "a road that nears an intersection",
    ),
    "side road": ("a road with a side road", "a road from which a smaller road branches off"),
    "several side streets": ("a road with several side streets", "a road with a number of side streets"),
    "lane added": ("a road that gains a lane", "a road where a lane is added"),
    "lane ends": ("a road where lanes merge", "a road that loses a lane"),
    "split": ("a road that splits", "a fork in the road"),
    "merge": ("a merge of two roads", "a road into which another merges"),
    "junction at the edge": ("a road with a junction at the edge of view", "a road with a junction further off"),
    "no road": ("an open area without marked lanes", "an area without lanes"),
}  # fmt: skip


def number_word(count: int) -> str:
    """As a word up to twelve."""
    return _NUMBERS[count] if count < len(_NUMBERS) else str(count)


def count_phrase(count: int, noun: str, rng: np.random.Generator) -> str:
    """``count`` things: as a number, or as vaguely as people speak, half of the time each."""
    many = _PLURALS.get(noun, f"{noun}s")
    if count == 0:
        return f"no {many}"
    if count == 1:
        return pick_phrase(rng, f"one {noun}", f"a single {noun}")
    if rng.random() < 0.5:
        return f"{number_word(count)} {many}"
    if count <= 3:
        return pick_phrase(rng, f"a few {many}", f"a couple of {many}" if count == 2 else f"some {many}")
    return (
        pick_phrase(rng, f"several {many}", f"multiple {many}")
        if count <= 7
        else pick_phrase(rng, f"many {many}", f"{many} in numbers")
    )


def lane_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """Lanes of the ego's road, to follow a noun ("with ..."); None off the road."""
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
        return pick_phrase(rng, exact, vague) if exact else pick_phrase(rng, vague, _both(same, opposite))
    return _both(same, opposite)


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
    gently, _, side = (facts.curve or "").rpartition(" ")
    return pick_phrase(rng, f"curving {gently} to the {side}", f"bending {gently} {side}").replace("  ", " ")


def intersection_sentence(facts: Facts, rng: np.random.Generator) -> str | None:
    """Where the intersection lies, as a sentence."""
    side, distance = facts.intersection_side, facts.intersection_distance
    if facts.intersection is None or side is None:
        return None
    if side == "inside":
        return pick_phrase(
            rng, "The ego vehicle is inside the intersection.", "The ego vehicle stands in the intersection."
        )
    where = {"ahead": "ahead", "behind": "behind the ego vehicle"}.get(side, f"to the {side}")
    if distance and rng.random() < 0.5:
        return f"The intersection is about {distance} m {where}."
    return f"The intersection is {where}."


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
    """What a plain road lacks, as a noun phrase; None where there is a joint of any kind."""
    if facts.layout not in ("straight", "curve", "winding"):
        return None
    things = ["intersections", "merges", "splits"]
    kept = [thing for thing in things if rng.random() < 0.7] or things[:1]
    return f"no {join_phrases(kept, 'or')}"


def motion_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """How the ego moves, as a predicate; None where its speed is unknown."""
    ways = {
        "stopped": ("is stopped", "stands still"), "slow": ("is moving slowly", "crawls along"),
        "moderate": ("is moving at moderate speed", "drives at a moderate speed"),
        "fast": ("is moving fast", "drives fast"),
    }  # fmt: skip
    found = ways.get(facts.traffic.ego_motion or "")
    return pick_phrase(rng, *found) if found else None


def relation_phrases(facts: Facts, rng: np.random.Generator) -> list[str]:
    """Vehicles by their relation to the ego, as noun phrases."""
    traffic = facts.traffic
    said = (
        (traffic.ahead, ("ahead in the ego lane", "in front of the ego vehicle")),
        (traffic.behind, ("behind the ego vehicle", "following the ego vehicle")),
        (traffic.left_lane, ("in the lane to the left", "in the left neighbouring lane")),
        (traffic.right_lane, ("in the lane to the right", "in the right neighbouring lane")),
        (traffic.oncoming, ("oncoming", "approaching from the opposite direction")),
        (traffic.crossing, ("on the crossing road", "crossing the ego's way")),
        (traffic.turning, ("turning", "in a turn")),
        (traffic.parked, ("parked beside the road", "parked off the lanes")),
    )
    return [f"{count_phrase(count, 'vehicle', rng)} {pick_phrase(rng, *ways)}" for count, ways in said if count]


def pedestrian_phrase(facts: Facts, rng: np.random.Generator) -> str | None:
    """Pedestrians and where they are, as a noun phrase; None without any."""
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
    """Rare events as noun phrases, never left out: they are what a scene is picked for."""
    ways = {
        "wrong-way driver": ("a wrong-way driver", "a vehicle driving the wrong way", "a vehicle on the wrong side"),
        "jaywalker": ("a jaywalker crossing the road", "a pedestrian crossing the road away from any crosswalk"),
        "stopped vehicle in lane": ("a vehicle stopped in its lane", "a broken-down vehicle blocking a lane"),
        "double parking": ("a double-parked vehicle", "a vehicle double parked beside the kerb"),
        "emergency corridor": ("an emergency corridor", "vehicles making way for an emergency vehicle"),
        "cut-in": ("a vehicle cutting in", "a vehicle that cuts into the next lane"),
    }  # fmt: skip
    return [pick_phrase(rng, *ways[event]) for event in facts.events]


def pick_phrase(rng: np.random.Generator, *choices: str) -> str:
    """One of several ways of saying something."""
    return choices[int(rng.integers(len(choices)))]


def join_phrases(parts: Sequence[str], last: str = "and") -> str:
    """An enumeration."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} {last} {parts[-1]}"


def _both(same: int, opposite: int) -> str:
    def said(count: int) -> str:
        return f"{number_word(count)} lane{'s' if count > 1 else ''}"

    return f"with {said(same)} in the ego's direction and {said(opposite)} in the other"
