"""Checks that logs and maps share: ids, ranges, and values that may be unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.scene.limits import MAX_COORDINATE


def check_known(name: str, values: np.ndarray) -> None:
    """ValueError if ``values`` hold infinity or absurd numbers; NaN stands for a value that is not known."""
    if (np.abs(values[~np.isnan(values)]) >= MAX_COORDINATE).any():
        raise ValueError(f"{name} holds infinite or absurd values: write NaN where a value is not known")


def check_range(name: str, values: np.ndarray, low: int, high: int) -> None:
    """ValueError if a value lies outside ``low``..``high``."""
    if values.size and not (low <= values.min() and values.max() <= high):
        raise ValueError(f"{name} holds values outside {low}..{high}: map the source's types to these")


def check_unique(name: str, ids: Sequence[str]) -> None:
    """ValueError if an id occurs twice; names it."""
    if len(set(ids)) == len(ids):
        return
    seen: set[str] = set()
    for item in ids:
        if item in seen:
            raise ValueError(f"{name} holds {item!r} more than once: ids must differ")
        seen.add(item)
