"""Damaged bytes and damaged JSON, as hypothesis draws them."""

from __future__ import annotations

import copy
from typing import Any

from hypothesis import strategies as st

WRONG_VALUES = st.sampled_from([None, -1, 2**40, 10**30, 1.5, "", "x", True, [], [1], {}, [[[]]]])


@st.composite
def damaged_bytes(draw: st.DrawFn, data: bytes) -> bytes:
    """``data`` cut short, with bits flipped, or with a block zeroed or left out."""
    kind, start = draw(st.sampled_from(["cut", "flip", "zero", "gap"])), draw(st.integers(0, len(data) - 1))
    if kind == "cut":
        return data[:start]
    if kind == "flip":
        damaged = bytearray(data)
        for place in {start, *draw(st.lists(st.integers(0, len(data) - 1), max_size=8))}:
            damaged[place] ^= 1 << draw(st.integers(0, 7))
        return bytes(damaged)
    end = min(start + draw(st.integers(1, 512)), len(data))
    return data[:start] + bytes(end - start if kind == "zero" else 0) + data[end:]


@st.composite
def damaged_json(draw: st.DrawFn, content: Any) -> Any:
    """``content`` with one value, at any depth, replaced, or left out of its object."""
    content = copy.deepcopy(content)
    path = draw(st.sampled_from([path for path in _paths(content) if path]))
    parent = content
    for key in path[:-1]:
        parent = parent[key]
    if isinstance(parent, dict) and draw(st.booleans()):
        del parent[path[-1]]
    else:
        parent[path[-1]] = draw(WRONG_VALUES)
    return content


def _paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(longer for key, inner in items for longer in _paths(inner, (*path, key)))]
