"""How well the facts of scenes agree: with the facts of a reference scene, or with labels of the synthetic world.

Facts of a generated scene and of its reference come from the same rules, so errors of a rule affect both; a copy of
the reference agrees fully.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Any

from scjax.language.facts import Facts
from scjax.metrics.pooling import Ratios

BINARY_ATTRIBUTES: dict[str, Callable[[Facts], bool]] = {
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
"""Attributes that a scene has or lacks: their F1 score is reported."""

CATEGORICAL_ATTRIBUTES: dict[str, Callable[[Facts], object]] = {
    "layout": lambda facts: facts.layout,
    "curve": lambda facts: facts.curve,
    "intersection kind": lambda facts: facts.intersection,
}
"""Attributes with several values: the share of scenes with equal values is reported."""

_LAYOUT_ATTRIBUTES = {
    "straight": "curved or straight",
    "curve": "curved or straight",
    "four-way": "intersection",
    "T": "intersection",
    "roundabout": "roundabout",
}


def fact_agreement(reference: Facts, generated: Facts) -> Ratios:
    """Contributions of one pair of scenes to the agreement metrics (metrics.md §4.4).

    Returns:
      "<attribute> F1": (2 true positives, positives of both) for ``BINARY_ATTRIBUTES`` and "red light"; the latter is
        (0, 0) where the reference records no signals.
      "<attribute> same": (equal, 1) for ``CATEGORICAL_ATTRIBUTES``.
      "lanes within 1", "vehicles within 1", "pedestrians within 1": (within, 1).
    """
    ratios: Ratios = {
        f"{name} F1": _f1(has_attribute(reference), has_attribute(generated))
        for name, has_attribute in BINARY_ATTRIBUTES.items()
    }
    red_light = _f1(reference.signals == "red", generated.signals == "red")
    ratios["red light F1"] = red_light if reference.signals is not None else (0.0, 0.0)
    for name, value in CATEGORICAL_ATTRIBUTES.items():
        ratios[f"{name} same"] = (float(value(reference) == value(generated)), 1.0)
    counts = {
        "lanes": (reference.lanes_same + reference.lanes_opposite, generated.lanes_same + generated.lanes_opposite),
        "vehicles": (reference.traffic.vehicles, generated.traffic.vehicles),
        "pedestrians": (reference.traffic.pedestrians, generated.traffic.pedestrians),
    }
    return ratios | {f"{name} within 1": (float(abs(one - two) <= 1), 1.0) for name, (one, two) in counts.items()}


def label_agreement(pairs: Iterable[tuple[dict[str, Any], Facts]]) -> dict[str, tuple[int, int]]:
    """How often the facts agree with the labels of synthetic scenes.

    Args:
      pairs: (label, facts) of each scene; a label is the JSON form of ``scjax.synthetic.labels.Label``.

    Returns:
      attribute -> (number of scenes that agree, number of scenes with a label).
    """
    matches: dict[str, list[bool]] = defaultdict(list)
    for label, facts in pairs:
        if label["layout"] is not None:
            matches[_LAYOUT_ATTRIBUTES[label["layout"]]].append(facts.layout == label["layout"])
        if label["signal"] is not None:
            matches["signal" if label["signal"] else "no signal"].append((facts.signals or "") == label["signal"])
        if label["event"] is not None:
            matches[f"event: {label['event']}"].append(label["event"] in facts.events)
        matches["no other event"].append(not set(facts.events) - {label["event"]})
    return {name: (sum(values), len(values)) for name, values in sorted(matches.items())}


def _f1(in_reference: bool, in_generated: bool) -> tuple[float, float]:
    return 2.0 * (in_reference and in_generated), float(in_reference) + float(in_generated)
