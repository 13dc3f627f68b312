"""Quantities as words state them: an exact number, at least so many, a few; each with the range it makes of a request.

A vague word is a generous range, an exact number of four or more one that reaches to both neighbors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from scjax.language.attributes.base import Bounds

VAGUE: dict[str, Bounds] = {
    "none": (0, 0),
    "one": (1, None),
    "some": (2, None),
    "couple": (2, 3),
    "few": (2, 5),
    "handful": (3, 7),
    "several": (3, 9),
    "many": (6, None),
    "dozens": (10, None),
    "hardly": (0, 3),
    "little": (0, 5),
}
"""Kinds that name no number; "one" is an article, as in "a car"."""

_EXACT_BELOW = 4  # smaller numbers are exact
_CAR_LENGTH, _FOOT = 4.5, 0.3048  # m
UNITS = {"m": 1.0, "feet": _FOOT, "lengths": _CAR_LENGTH}
"""Unit of a distance -> meters."""
_MIN_DISTANCE_TOLERANCE = 3.0  # m
_MIN_DISTANCE = 2.0  # m, the least that somebody states


class StatedQuantity(NamedTuple):
    """What words state about a number.

    Attributes:
      kind: a key of ``VAGUE`` or ``NUMBERED``.
      numbers: those that the words name.
      bounds: of the request that they make.
      unit: of distances, a key of ``UNITS``.
    """

    kind: str
    numbers: tuple[int, ...]
    bounds: Bounds
    unit: str = ""

    def holds(self, value: int | float) -> bool:
        """Whether a number is within the bounds."""
        least, most = self.bounds
        return least <= value and (most is None or value <= most)


def about_margin(number: int) -> int:
    """How far "about" reaches from a number, to both sides."""
    return 2 if number < 18 else 3


NUMBER_BOUNDS: dict[str, Callable[[int], Bounds]] = {
    "exactly": lambda n: (n, n),
    "at_least": lambda n: (n, None),
    "more_than": lambda n: (n + 1, None),
    "at_most": lambda n: (0, n),
    "fewer_than": lambda n: (0, max(n - 1, 0)),
    "about": lambda n: (n - about_margin(n), n + about_margin(n)),
}
"""Comparison -> the range that it makes of its number."""


def _compared(kind: str, number: int) -> StatedQuantity:
    return StatedQuantity(kind, (number,), NUMBER_BOUNDS[kind](number))


def _exact(value: int, rng: np.random.Generator) -> StatedQuantity:
    margin = 0 if value < _EXACT_BELOW else 1
    return StatedQuantity("exact", (value,), (value - margin, value + margin))


def _exactly(value: int, rng: np.random.Generator) -> StatedQuantity:
    return _compared("exactly", value)


def _at_least(value: int, rng: np.random.Generator) -> StatedQuantity:
    return _compared("at_least", max(1, value - int(rng.integers(4))))


def _more_than(value: int, rng: np.random.Generator) -> StatedQuantity:
    return _compared("more_than", max(1, value - 1 - int(rng.integers(4))))


def _at_most(value: int, rng: np.random.Generator) -> StatedQuantity:
    return _compared("at_most", max(1, value + int(rng.integers(4))))


def _fewer_than(value: int, rng: np.random.Generator) -> StatedQuantity:
    return _compared("fewer_than", max(2, value + 1 + int(rng.integers(4))))


def _about(value: int, rng: np.random.Generator) -> StatedQuantity:
    margin, number = about_margin(value), max(_EXACT_BELOW, value + int(rng.integers(-1, 2)))
    return StatedQuantity("about", (number,), (number - margin, number + margin))


def _between(value: int, rng: np.random.Generator) -> StatedQuantity:
    low = max(1, value - int(rng.integers(3)))
    high = max(value, low + 1) + int(rng.integers(2))
    return StatedQuantity("between", (low, high), (low, high))


NUMBERED: dict[str, Callable[[int, np.random.Generator], StatedQuantity]] = {
    "exact": _exact,
    "exactly": _exactly,
    "at_least": _at_least,
    "more_than": _more_than,
    "at_most": _at_most,
    "fewer_than": _fewer_than,
    "about": _about,
    "between": _between,
}
"""Kinds that name numbers -> a quantity near a value."""

KINDS = (*VAGUE, *NUMBERED)


def draw_quantity(kind: str, value: int, rng: np.random.Generator) -> StatedQuantity | None:
    """A quantity of a kind that holds for ``value``; None where none does.

    Raises:
      ValueError: an unknown kind.
    """
    if kind in VAGUE:
        quantity = StatedQuantity(kind, (), VAGUE[kind])
    elif kind not in NUMBERED:
        raise ValueError(f"there is no kind of quantity {kind!r}: choose from {', '.join(KINDS)}")
    elif value < 1:
        return None
    else:
        quantity = NUMBERED[kind](value, rng)
    return quantity if quantity.holds(value) else None


def draw_distance(
    kind: str, value: int | float | None, units: tuple[str, ...], rng: np.random.Generator
) -> StatedQuantity | None:
    """A distance that holds for ``value`` [m]; None where none does.

    Args:
      kind: "exact", "at_least" or "at_most".
      value: None means that nothing is there, for which only "at_least" holds.
      units: keys of ``UNITS`` to draw from.
    """
    unit = units[int(rng.integers(len(units)))]
    size = UNITS[unit]
    step = {"m": int(rng.choice([1, 5])), "feet": 5, "lengths": 1}[unit]
    target = float(rng.uniform(8.0, 40.0)) if value is None else value
    if kind == "at_least":
        number = math.floor(target * float(rng.uniform(0.6, 1.0)) / size / step) * step
        bounds = (number * size, None)
    elif kind == "at_most":
        number = math.ceil(target * float(rng.uniform(1.0, 1.4)) / size / step) * step
        bounds = (0, number * size)
    else:
        number = round(target / size / step) * step
        margin = max(_MIN_DISTANCE_TOLERANCE, round(0.25 * number * size))
        bounds = (max(0.0, number * size - margin), number * size + margin)
    quantity = StatedQuantity(kind, (number,), _rounded(bounds), unit)
    if number * size < _MIN_DISTANCE or (value is None and quantity.bounds[1] is not None):
        return None
    return quantity if value is None or quantity.holds(value) else None


def _rounded(bounds: Bounds) -> Bounds:
    least, most = bounds
    return round(least, 2), None if most is None else round(most, 2)
