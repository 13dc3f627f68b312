"""Requests that a measured scene fulfills: what somebody who wants such a scene might ask for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scjax.language.attributes.base import Attribute, Bounds
from scjax.language.attributes.table import ATTRIBUTES

_NOTHING, _EVERYTHING = 0.1, 0.05  # shares of requests
_EXACT, _NEAR, _OPEN = 0.45, 0.15, 0.25  # shares of ranges; the rest have two loose ends
_LOOSE = 4  # how far a loose end lies from a count, at most, and by how many tenths of it from a length


def draw_attributes(measured: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A request in its normal form that a scene of these measurements fulfills.

    A tenth of the requests ask nothing and a twentieth ask for everything. The others ask for each attribute with a
    probability of their own: many for a few, some for most.

    Args:
      measured: from ``measure_attributes``.
    """
    kind = rng.random()
    if kind < _NOTHING:
        return {}
    share = 1.0 if kind < _NOTHING + _EVERYTHING else float(rng.beta(0.6, 1.6))
    request = {}
    for name, attribute in ATTRIBUTES.items():
        if rng.random() < share:
            value = _draw_value(attribute, measured[name], rng)
            if value is not None:
                request[name] = value
    return request


def full_request(measured: Mapping[str, Any]) -> dict[str, Any]:
    """All that a scene of these measurements shows, as a request in its normal form: numbers exactly."""
    request = {}
    for name, value in measured.items():
        kind = ATTRIBUTES[name].kind
        if name != "not_layout" and value is not None and value != ():
            request[name] = value[0] if kind == "choice" else (value, value) if kind == "range" else value
    return request


def _draw_value(attribute: Attribute, measured: Any, rng: np.random.Generator) -> Any:
    """A request for one attribute; None if there is nothing to ask for."""
    if attribute.kind == "range":
        return _draw_bounds(attribute, measured, rng)
    if attribute.kind == "flag" or not measured:
        return measured if attribute.kind == "flag" else None
    if attribute.kind == "choice":  # the best one first
        return measured[0] if rng.random() < 0.5 else measured[int(rng.integers(len(measured)))]
    number = 1 + int(rng.integers(min(len(measured), 3)))
    chosen = set(rng.choice(len(measured), number, replace=False).tolist())
    return tuple(value for k, value in enumerate(measured) if k in chosen)


def _draw_bounds(attribute: Attribute, measured: int | float | None, rng: np.random.Generator) -> Bounds | None:
    low, high = attribute.limits
    if measured is None:
        return (int(rng.integers(low + 1, 40)), None) if attribute.open_without else None
    kind, is_count = rng.random(), not attribute.unit
    if not low <= measured <= high:
        return None
    if is_count and kind < _EXACT:
        return int(measured), int(measured)
    loose = _LOOSE if is_count else max(1.0, measured * _LOOSE / 10)
    below, above = (float(rng.random() * loose) for _ in range(2))
    if kind < _EXACT + _NEAR:
        below = above = 1.0 if is_count else loose / 4
    least, most = max(low, int(np.floor(measured - below))), min(high, int(np.ceil(measured + above)))
    if kind < _EXACT + _NEAR + _OPEN:
        least, most = (least, None) if rng.random() < 0.6 else (low, most)
    return None if least == low and most in (None, high) else (least, most)  # that would request nothing
