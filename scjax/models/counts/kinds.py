"""How many agents of each kind a scene has: drawn from the numbers in scenes of the training.

A table has a row for every different set of numbers: vehicles, pedestrians, cyclists, static objects and large vehicles
(which are vehicles, too), all besides the ego, and last in how many scenes they occurred.
"""

from __future__ import annotations

import collections
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Int

KINDS = ("vehicles", "pedestrians", "cyclists", "static", "large")
"""Columns of a table, named as the attributes that count them."""

KindTable = Int[np.ndarray, "rows columns"]
KindCounts = Int[np.ndarray, " kinds"]

_CLASSES = slice(0, 4)  # columns that add up to all agents
_PARTS = {
    "vehicles": ("ahead", "behind", "left_lane", "right_lane", "oncoming", "crossing", "parked", "stopped", "large"),
    "pedestrians": ("pedestrians_on_road", "pedestrians_ahead"),
}
_NEEDED = {  # request -> kind and the least number that it needs
    ("queue", True): ("vehicles", 3),
    ("event", "work-zone"): ("static", 3),
    ("event", "jaywalker"): ("pedestrians", 1),
    ("event", "cut-in"): ("vehicles", 2),
    ("event", "double-parking"): ("vehicles", 2),
    ("event", "wrong-way"): ("vehicles", 1),
    ("event", "stopped-in-lane"): ("vehicles", 1),
    ("event", "emergency-corridor"): ("vehicles", 4),
}


def kind_table(measured: Iterable[Mapping[str, Any]]) -> KindTable:
    """The table of scenes with these measurements (``measure_attributes``), the most frequent row first."""
    rows = collections.Counter(tuple(int(scene[name]) for name in KINDS) for scene in measured)
    return np.array([(*row, number) for row, number in rows.most_common()], np.int32).reshape(-1, len(KINDS) + 1)


def draw_kind_counts(
    rng: np.random.Generator,
    table: KindTable,
    totals: Float[np.ndarray, " totals"],
    request: Mapping[str, Any],
    *,
    least: KindCounts,
    most: int,
    total: int | None = None,
) -> KindCounts | None:
    """Numbers of agents by kind, besides the ego.

    Of the rows that fulfill the request, and have ``least`` of each kind, one is drawn: its total by ``totals``, and
    within the total by frequency. Without such a row, what is requested at least is there, and nothing else; None if
    the total is given.

    Args:
      totals: probability of every number of agents, the ego included.
      request: attributes in their normal form.
      most: agents that a scene may have, the ego included.
      total: their number, if it is given.
    """
    counts, frequency = table[:, :-1], table[:, -1].astype(np.float64)
    agents = 1 + counts[:, _CLASSES].sum(1)
    fits = _fulfill(counts, request) & (counts >= least).all(1) & (agents <= most)
    weights = np.where(fits if total is None else fits & (agents == total), frequency, 0)
    of_total = np.bincount(agents, frequency)
    likely = np.append(totals, np.zeros(max(agents.max(initial=0) + 1 - len(totals), 0)))
    for likelihoods in (weights / of_total[agents] * likely[agents], weights):
        if likelihoods.sum() > 0:
            return counts[rng.choice(len(counts), p=likelihoods / likelihoods.sum())]
    return _smallest(request, least, most) if total is None else None


def least_counts(request: Mapping[str, Any]) -> KindCounts:
    """The least numbers that a request calls for, by kind, those of its parts and events included."""
    least = {name: int(request[name][0]) if name in request else 0 for name in KINDS}
    for name, parts in _PARTS.items():
        least[name] = max([least[name], *(int(request[part][0]) for part in parts if part in request)])
    for (attribute, value), (name, number) in _NEEDED.items():
        stated = request.get(attribute, ())
        if stated is value or (isinstance(stated, tuple) and value in stated):
            least[name] = max(least[name], number)
    return np.array([least[name] for name in KINDS], np.int32)


def _fulfill(counts: Int[np.ndarray, "rows kinds"], request: Mapping[str, Any]) -> np.ndarray:
    fits = np.asarray((counts >= least_counts(request)).all(1))
    columns = dict(zip(KINDS, counts.T, strict=True))
    for name in KINDS:
        _, high = request.get(name, (0, None))
        if high is not None:
            fits &= columns[name] <= high
    for more, less in (pair.split(" > ") for pair in request.get("compare", ())):
        fits &= columns[more] > columns[less]
    return fits


def _smallest(request: Mapping[str, Any], least: KindCounts, most: int) -> KindCounts:
    """What must be there, cut to the largest scene: the classes in their order."""
    counts, room = np.maximum(least_counts(request), least), most - 1
    for column in range(len(counts))[_CLASSES]:
        counts[column] = min(counts[column], room)
        room -= counts[column]
    counts[-1] = min(counts[-1], counts[0])
    return counts
