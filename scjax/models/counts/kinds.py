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
    within the total by frequency. Without such a row there are ``least``, and nothing else; None if the total is given.

    Args:
      totals: probability of every number of agents, the ego included.
      request: attributes in their normal form.
      least: numbers that the request and known agents call for.
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
    return _cut(least, most) if total is None else None


def _fulfill(counts: Int[np.ndarray, "rows kinds"], request: Mapping[str, Any]) -> np.ndarray:
    fits = np.ones(len(counts), bool)
    columns = dict(zip(KINDS, counts.T, strict=True))
    for name in KINDS:
        _, high = request.get(name, (0, None))
        if high is not None:
            fits &= columns[name] <= high
    for more, less in (pair.split(" > ") for pair in request.get("compare", ())):
        fits &= columns[more] > columns[less]
    return fits


def _cut(least: KindCounts, most: int) -> KindCounts:
    """``least`` cut to the largest scene: the classes in their order."""
    counts, room = least.copy(), most - 1
    for column in range(len(counts))[_CLASSES]:
        counts[column] = min(counts[column], room)
        room -= counts[column]
    counts[-1] = min(counts[-1], counts[0])
    return counts
