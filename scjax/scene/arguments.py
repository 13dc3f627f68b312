"""Checks of arguments: type, range and finiteness, with the name of the argument in every message.

Whole floats and NumPy numbers count as numbers everywhere; booleans never do.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Collection
from typing import Any

import numpy as np


def whole_number(value: Any, name: str, low: int, high: int) -> int:
    """``value`` as an int in ``low``..``high``.

    Raises:
      ValueError: it is no whole number, or out of range.
    """
    number = _scalar(value)
    if isinstance(number, float) and number.is_integer():
        number = int(number)
    if not isinstance(number, int) or not low <= number <= high:
        raise ValueError(f"{name} must be a whole number in {low}..{high}, not {_shown(value)}")
    return number


def finite_number(value: Any, name: str, low: float = -math.inf, high: float = math.inf) -> float:
    """``value`` as a finite float in ``low``..``high``.

    Raises:
      ValueError: it is no number, or out of range.
    """
    number = _scalar(value)
    if isinstance(number, int) and abs(number) > 1 << 1000:  # no float holds it
        number = math.inf
    if not isinstance(number, int | float) or not math.isfinite(number) or not low <= number <= high:
        bounds = f" in {low:g}..{high:g}" if math.isfinite(high) else f" of at least {low:g}" if low > -math.inf else ""
        raise ValueError(f"{name} must be a finite number{bounds}, not {_shown(value)}")
    return float(number)


def truth_value(value: Any, name: str) -> bool:
    """``value`` as a bool; ValueError if it is none."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True or False, not {_shown(value)}")
    return bool(value)


def listed_choice(value: Any, name: str, choices: Collection[str]) -> str:
    """``value``, if it is one of the words; ValueError lists them."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, not {_shown(value)}")
    return value


def _scalar(value: Any) -> Any:
    """A Python int or float of a number of any library; anything else stays or becomes None."""
    if isinstance(value, bool | np.bool_ | str | bytes):
        return None
    if isinstance(value, int | float):
        return value
    if getattr(value, "shape", None) == () and getattr(value, "dtype", None) is not None:
        try:
            return np.asarray(value).item() if np.asarray(value).dtype.kind in "iuf" else None
        except Exception:  # arrays of other libraries, traced values
            return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def _shown(value: Any) -> str:
    """The value in a message, cut; arrays by shape."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"an array of shape {tuple(value.shape)} of {value.dtype}"
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:80]}..."
