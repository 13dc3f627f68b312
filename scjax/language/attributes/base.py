"""The form of an attribute: what it means, which requests it takes, and when a scene fulfills one."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from scjax.language.analysis.scene_analysis import Analysis

Kind = Literal["choice", "flag", "range", "set"]
Bounds = tuple[int | float, int | float | None]

_HUGE = 1e15  # no number of a request or scene is larger

UNSPECIFIED = "unspecified"
"""A request that asks nothing, as does a missing key or None."""

TAKES: dict[Kind, str] = {
    "choice": "one of its values",
    "flag": "true or false",
    "range": "a number, or [least, most] where null leaves an end open",
    "set": "a list of its values, all of which must be there",
}
"""What a request for each kind of attribute looks like."""


@dataclasses.dataclass(frozen=True)
class Attribute:
    """One thing that can be measured on a scene and requested of one.

    Attributes:
      name: key of requests and measurements.
      kind: form of requests and of measurements. A choice is measured as a tuple of all values that fit, the best one
        first; a flag as a bool; a range as a number, or None where there is nothing to measure; a set as a tuple.
      meaning: one sentence.
      measure: from the analysis of a scene to the measurement.
      values: of choices and sets.
      unit: of ranges; "" for counts.
      limits: least and largest number that a request may name.
      open_without: whether a range without an upper end also holds where there is nothing to measure.
    """

    name: str
    kind: Kind
    meaning: str
    measure: Callable[[Analysis], Any]
    values: tuple[str, ...] = ()
    unit: str = ""
    limits: tuple[int, int] = (0, 100)
    open_without: bool = False

    def check(self, request: Any) -> Any:
        """The request in its normal form: a value, a bool, ``(least, most or None)``, or a tuple of values.

        Raises:
          ValueError: another type, value or range; names the attribute, the cause and the cure.
        """
        if self.kind == "flag":
            if isinstance(request, bool | np.bool_):
                return bool(request)
            raise ValueError(f"{self.name} is {_shown(request)}: give true or false")
        if self.kind == "range":
            return self._bounds(request)
        if self.kind == "choice":
            return self._value(request)
        names = [request] if isinstance(request, str) else request
        if not isinstance(names, list | tuple | set | frozenset) or not names:
            raise ValueError(f"{self.name} is {_shown(request)}: give a list of {', '.join(self.values)}")
        chosen = {self._value(name) for name in names}
        return tuple(value for value in self.values if value in chosen)

    def holds(self, request: Any, measured: Any) -> bool:
        """Whether a measurement fulfills a request in its normal form."""
        if self.kind == "choice":
            return request in measured
        if self.kind == "flag":
            return measured is request
        if self.kind == "set":
            return set(request) <= set(measured)
        least, most = request
        if measured is None:
            return self.open_without and most is None
        return least <= measured and (most is None or measured <= most)

    def check_measured(self, value: Any) -> Any:
        """A measurement as ``measure`` gives it, from its JSON form.

        Raises:
          ValueError: it is none of this attribute.
        """
        if self.kind == "flag" and (value is None or isinstance(value, bool)):  # None: nothing to measure
            return value
        is_count = self.kind == "range" and not self.unit
        if self.kind == "range" and (value is None or (_is_number(value) and value >= 0)):
            if value is None or not is_count or value == int(value):
                return value
        if self.kind in ("choice", "set") and isinstance(value, list) and all(one in self.values for one in value):
            return tuple(value)
        raise ValueError(f"{self.name} cannot be measured as {_shown(value)}")

    def _value(self, request: Any) -> str:
        if isinstance(request, str) and request in self.values:
            return request
        near = difflib.get_close_matches(str(request), self.values, 1)
        cure = f"write {near[0]!r}" if near else f"give one of {', '.join(self.values)}"
        raise ValueError(f"{self.name} has no value {_shown(request)}: {cure}")

    def _bounds(self, request: Any) -> Bounds:
        ends = list(request) if isinstance(request, list | tuple) else [request, request]
        if len(ends) != 2 or ends == [None, None] or not all(end is None or _is_number(end) for end in ends):
            raise ValueError(
                f"{self.name} is {_shown(request)}: give a number or [least, most], where null leaves an end open"
            )
        low, high = self.limits
        for end in ends:
            if end is not None and not low <= end <= high:
                raise ValueError(f"{self.name} is {_shown(request)}: give numbers from {low:g} to {high:g}")
        least, most = (low if ends[0] is None else ends[0]), ends[1]
        if most is not None and least > most:
            raise ValueError(f"{self.name} is {_shown(request)}: give the least number first")
        return least, most


def _is_number(value: Any) -> bool:
    is_real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool | np.bool_)
    return is_real and bool(-_HUGE < value < _HUGE)


def _shown(request: Any) -> str:
    text = repr(request)
    return text if len(text) <= 60 else f"{text[:60]}..."


def count_of(rows: np.ndarray) -> int:
    """Number of True entries, as a plain int."""
    return int(np.count_nonzero(rows))
