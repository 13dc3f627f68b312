"""Does a generated scene show what its reference's caption says? One attribute of the facts each (metrics.md §4.4).

Facts of the generated scene come from the same rules as those of the reference, so a rule's own faults are on both
sides; a copy agrees fully.
"""

from __future__ import annotations

from collections.abc import Callable

from scjax.language.facts import Facts
from scjax.metrics.pooling import Ratios

PRESENT: dict[str, Callable[[Facts], bool]] = {
    "intersection": lambda facts: facts.intersection is not None,
    "side street": lambda facts: facts.side_streets_left + facts.side_streets_right > 0,
    "turn lane": lambda facts: bool(facts.turn_lanes),
    "opposite lanes": lambda facts: facts.lanes_opposite > 0,
    "vehicle ahead": lambda facts: facts.traffic.ahead > 0,
    "oncoming": lambda facts: facts.traffic.oncoming > 0,
    "parked": lambda facts: facts.traffic.parked > 0,
    "pedestrians": lambda facts: facts.traffic.pedestrians > 0,
    "cyclists": lambda facts: facts.traffic.cyclists > 0,
}
"""Attributes that a scene has or lacks: their F1 is reported."""

SAME: dict[str, Callable[[Facts], object]] = {
    "layout": lambda facts: facts.layout,
    "curve": lambda facts: facts.curve,
    "intersection kind": lambda facts: facts.intersection,
}
"""Attributes of several values: the share of scenes that agree is reported."""

_SIGNALS = "red light"


def agreement(reference: Facts, generated: Facts) -> Ratios:
    """Contributions of one pair of scenes.

    Returns:
      "<attribute> F1": (2 hits, said + shown) of ``PRESENT``; where the reference records signals also of "red light".
      "<attribute> same": of ``SAME``; "lanes within 1", "vehicles within 1", "pedestrians within 1": (hits, scenes).
    """
    found: Ratios = {f"{name} F1": _f1(has(reference), has(generated)) for name, has in PRESENT.items()}
    known = reference.signals is not None
    red = _f1(reference.signals == "red", generated.signals == "red")
    found[f"{_SIGNALS} F1"] = red if known else (0.0, 0.0)
    for name, value in SAME.items():
        found[f"{name} same"] = (float(value(reference) == value(generated)), 1.0)
    near = {
        "lanes": (reference.lanes_same + reference.lanes_opposite, generated.lanes_same + generated.lanes_opposite),
        "vehicles": (reference.traffic.vehicles, generated.traffic.vehicles),
        "pedestrians": (reference.traffic.pedestrians, generated.traffic.pedestrians),
    }
    return found | {f"{name} within 1": (float(abs(one - two) <= 1), 1.0) for name, (one, two) in near.items()}


def _f1(said: bool, shown: bool) -> tuple[float, float]:
    return 2.0 * (said and shown), float(said) + float(shown)
