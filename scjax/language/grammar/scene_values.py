"""What may be said: of a scene that was measured, or freely."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from scjax.language.attributes.base import UNSPECIFIED, Bounds
from scjax.language.attributes.table import ATTRIBUTES
from scjax.language.grammar.phrasebook import SLOTS, Entry
from scjax.language.grammar.quantities import StatedQuantity, draw_distance, draw_quantity

_FREE_COUNTS = (0.16, 0.22, 0.17, 0.12, 0.08, 0.06, 0.05, 0.04)  # of 0 to 7; the rest is spread up to 40
_MOST_FREE = 40
_SMALL_LIMITS = {"lanes_same": 5, "lanes_opposite": 5, "lanes_total": 9, "ego_lane_index": 5}
_MANY = ("vehicles", "pedestrians", "static", "parked", "stopped")
_MOST_OTHERS = 7


@runtime_checkable
class ValueSource(Protocol):
    """What attributes of a scene may be said to be."""

    def shows(self, name: str, value: Any) -> bool:
        """Whether a request in its normal form may be stated."""
        ...

    def number(self, name: str) -> int | float | None:
        """The number to state for an attribute; None where it has none."""
        ...

    def tie(self, names: Sequence[str]) -> None:
        """Makes attributes that share a slot equal, where that is free."""
        ...


@dataclasses.dataclass(frozen=True)
class MeasuredValues:
    """A scene: only what it shows may be said."""

    measured: Mapping[str, Any]

    def shows(self, name: str, value: Any) -> bool:
        """Whether the scene fulfills the request."""
        return ATTRIBUTES[name].holds(value, self.measured[name])

    def number(self, name: str) -> int | float | None:
        """The measurement."""
        return self.measured[name]

    def tie(self, names: Sequence[str]) -> None:
        """A scene is as it is."""


class FreeValues:
    """No scene: everything may be said, and numbers are drawn."""

    def __init__(self, rng: np.random.Generator):
        self._rng = rng
        self._numbers: dict[str, int | float] = {}

    def shows(self, name: str, value: Any) -> bool:
        """Always."""
        return value != UNSPECIFIED

    def number(self, name: str) -> int | float | None:
        """A random number, the same one at every call; of lanes few."""
        if name not in self._numbers:
            self._numbers[name] = self._draw(name)
        return self._numbers[name]

    def tie(self, names: Sequence[str]) -> None:
        """All get the least of their numbers."""
        least = min(self.number(name) or 0 for name in names)
        self._numbers |= dict.fromkeys(names, least)

    def _draw(self, name: str) -> int | float:
        if ATTRIBUTES[name].unit:
            return float(self._rng.uniform(2.0, 40.0))
        if name in _SMALL_LIMITS:
            least = ATTRIBUTES[name].limits[0]
            return int(self._rng.integers(max(least, name != "lanes_opposite"), _SMALL_LIMITS[name]))
        value = int(self._rng.choice(len(_FREE_COUNTS) + 1, p=[*_FREE_COUNTS, 1 - sum(_FREE_COUNTS)]))
        if value == len(_FREE_COUNTS):
            value = int(self._rng.integers(len(_FREE_COUNTS), _MOST_FREE))
        return value if name in _MANY else min(value, _MOST_OTHERS)


def fitting_quantities(
    entry: Entry, kinds: Sequence[str], values: ValueSource, units: tuple[str, ...], rng: np.random.Generator
) -> dict[str, StatedQuantity] | None:
    """Slot -> a quantity of one of the kinds that may be stated; None where an entry does not fit the values."""
    if not all(values.shows(name, value) for name, value in entry.values.items()):
        return None
    quantities = {}
    for slot, names in entry.slots.items():
        quantity = _quantity(SLOTS[slot], names, kinds, values, units, rng)
        if quantity is None:
            return None
        quantities[slot] = quantity
    return quantities


def stated_request(entry: Entry, quantities: Mapping[str, StatedQuantity]) -> dict[str, Any]:
    """The request that an entry makes with its slots filled, in its normal form."""
    bounds = {name: _limited(name, quantities[slot].bounds) for slot, names in entry.slots.items() for name in names}
    return {**entry.values, **bounds}


def _limited(name: str, bounds: Bounds) -> Bounds:
    low, high = ATTRIBUTES[name].limits
    least, most = bounds
    return min(max(least, low), high), None if most is None else min(most, high)


def _quantity(
    statement: str,
    names: tuple[str, ...],
    kinds: Sequence[str],
    values: ValueSource,
    units: tuple[str, ...],
    rng: np.random.Generator,
) -> StatedQuantity | None:
    if len(names) > 1:
        values.tie(names)
    numbers = [values.number(name) for name in names]
    if statement == "distance":
        return draw_distance(kinds[int(rng.integers(len(kinds)))], numbers[0], units, rng)
    if any(number is None for number in numbers):
        return None
    value = int(numbers[0] or 0)
    if statement in ("index", "ordinal"):
        return StatedQuantity("exactly", (value,), (value, value)) if value > 0 and len(set(numbers)) == 1 else None
    for kind in rng.permutation(_weighted(kinds, value)):
        quantity = draw_quantity(str(kind), value, rng)
        if quantity is not None and all(quantity.holds(float(number or 0)) for number in numbers):
            return quantity
    return None


def _weighted(kinds: Sequence[str], value: int) -> list[str]:
    """Kinds, those that people use most several times."""
    often = {"none": 12} if not value else {"exact": 6, "one": 4 if value == 1 else 1, "some": 2}
    return [kind for kind in kinds for _ in range(often.get(kind, 1))]
