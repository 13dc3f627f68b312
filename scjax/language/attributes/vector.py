"""Requests as vectors of numbers in 0..1, one number for each named feature; what is not requested is all zeros.

A value of a choice, flag or set is one feature. A range is a thermometer: ``vehicles>=3`` is 1 where at least three or
more are requested, ``vehicles<=3`` where three or fewer are; between two levels the number grows in a straight line. So
an open end and no request are both zero, and equal requests are equal vectors.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from scjax.language.attributes.base import Attribute
from scjax.language.attributes.table import ATTRIBUTES, check_attributes

_COUNTS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 17, 20, 25, 30, 40, 60, 100)
_METERS = (0, 2, 4, 6, 8, 10, 13, 16, 20, 25, 30, 40, 60, 100)


def feature_names() -> tuple[str, ...]:
    """Names of all features, in the order of the table of attributes."""
    return tuple(name for attribute in ATTRIBUTES.values() for name in _names(attribute))


def request_vector(request: Mapping[str, Any], names: Sequence[str]) -> Float[np.ndarray, " names"]:
    """A request as float32 values of the features ``names``; what it requests beyond them is left out.

    Raises:
      ValueError: as ``check_attributes``.
    """
    features: dict[str, float] = {}
    for name, value in check_attributes(request).items():
        features |= _features(ATTRIBUTES[name], value)
    return np.array([features.get(name, 0.0) for name in names], np.float32)


@functools.cache
def _names(attribute: Attribute) -> tuple[str, ...]:
    if attribute.kind == "range":
        levels = _levels(attribute)
        return tuple(f"{attribute.name}>={k}" for k in levels[1:]) + tuple(
            f"{attribute.name}<={k}" for k in levels[:-1]
        )
    values = ("true", "false") if attribute.kind == "flag" else attribute.values
    return tuple(f"{attribute.name}={value}" for value in values)


def _features(attribute: Attribute, value: Any) -> dict[str, float]:
    """Feature -> number of a request in its normal form, without zeros."""
    if attribute.kind == "choice":
        return {f"{attribute.name}={value}": 1.0}
    if attribute.kind == "flag":
        return {f"{attribute.name}={str(value).lower()}": 1.0}
    if attribute.kind == "set":
        return {f"{attribute.name}={one}": 1.0 for one in value}
    levels, (least, most) = np.array(_levels(attribute), float), value
    steps = np.diff(levels)
    at_least = np.clip((least - levels[:-1]) / steps, 0, 1)
    at_most = np.clip((levels[1:] - (levels[-1] if most is None else most)) / steps, 0, 1)
    return dict(zip(_names(attribute), [*at_least.tolist(), *at_most.tolist()], strict=True))


@functools.cache
def _levels(attribute: Attribute) -> tuple[int, ...]:
    """Levels of the thermometer, from the least to the largest number that a request may name."""
    low, high = attribute.limits
    return tuple(level for level in (_METERS if attribute.unit else _COUNTS) if low <= level <= high)
