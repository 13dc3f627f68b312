"""Piecewise cubic polynomials of the arc length: elevation, lane offset, widths and borders."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Float64

from scjax.data.readers.xml_elements import Element

_MAX_COEFFICIENT = 1e30  # exporters write huge ones for stretches of a micrometer


@dataclasses.dataclass(frozen=True)
class Cubics:
    """Polynomials a + b ds + c ds² + d ds³, each from its start to the start of the next one.

    Attributes:
      starts: where each begins [m], increasing.
      coefficients: a, b, c, d of each.
    """

    starts: Float64[np.ndarray, " records"]
    coefficients: Float64[np.ndarray, "records 4"]

    def values(self, s: Float64[np.ndarray, " n"], at: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Values at ``s``; before the first start, that at the first start.

        Args:
          at: places [m] that say which record counts: at the end of a stretch, a place before its end.
        """
        row = np.maximum(np.searchsorted(self.starts, at, side="right") - 1, 0)
        ds = np.maximum(s - self.starts[row], 0.0)
        a, b, c, d = self.coefficients[row].T
        return a + ds * (b + ds * (c + ds * d))


def constant(value: float) -> Cubics:
    """The same value everywhere."""
    return Cubics(np.zeros(1), np.array([[value, 0.0, 0.0, 0.0]]))


def read_cubics(
    elements: Iterable[Element], start: str = "s", shift: float = 0.0, *, zero_before: bool = False
) -> Cubics:
    """Records of the attributes ``start``, a, b, c, d; 0 without any. Of two with one start the later counts.

    Args:
      start: name of the attribute of the start [m].
      shift: added to the starts [m].
      zero_before: 0 before the first record, not the value there.

    Raises:
      ValueError: a number is missing or absurd; says where.
    """
    records = [
        (shift + element.number(start), *(element.number(name, 0.0, most=_MAX_COEFFICIENT) for name in "abcd"))
        for element in elements
    ]
    if not records:
        return constant(0.0)
    records.sort(key=lambda record: record[0])
    if zero_before and records[0][0] > shift:
        records.insert(0, (shift, 0.0, 0.0, 0.0, 0.0))
    table = np.array(records)
    table = table[np.append(np.diff(table[:, 0]) > 0, True)]
    return Cubics(table[:, 0], table[:, 1:])
