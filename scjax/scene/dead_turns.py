"""Lanes that lead nowhere: which of them can be left out, up to the place where the road has another way."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TypeVar

Name = TypeVar("Name", int, str)

_LONGEST = 40.0  # m of lanes that are left out together


def dead_turn(
    lane: Name,
    before: Mapping[Name, Collection[Name]],
    after: Mapping[Name, Collection[Name]],
    lengths: Mapping[Name, float],
    *,
    kept: Collection[Name],
    removed: Collection[Name] = (),
    from_border: Collection[object] = (),
) -> set[Name]:
    """Lanes that can go if nothing follows ``lane``: it, and those before it that lead to it alone.

    No lane can go if one of them is kept, if they are longer than 40 m together, or if a lane would begin at nothing
    instead. A way that begins at the border of the window, and has no other goal, goes as a whole.

    Args:
      lane: at whose end nothing follows. For a lane that follows nothing, exchange ``before`` and ``after``.
      before, after: lanes of every lane that it follows, and that follow it.
      lengths: of the lanes [m].
      kept: lanes that stay.
      removed: lanes that are left out already.
      from_border: lanes that begin at the border.
    """
    at, turn = lane, set()
    while True:
        turn.add(at)
        others = set(before[at]) - set(removed)
        if at in kept or sum(lengths[item] for item in turn) > _LONGEST:
            return set()
        if not others:
            return turn if at in from_border else set()
        only_way = [item for item in others if not set(after[item]) - set(removed) - turn]
        if not only_way:
            return turn
        if len(others) > 1:
            return set()
        (at,) = only_way
