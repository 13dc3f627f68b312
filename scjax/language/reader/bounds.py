"""Ranges that a text with certain numbers can state: a pair of ends that no wording makes is unlikely."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from scjax.language.attributes.base import Bounds
from scjax.language.grammar.quantities import NUMBER_BOUNDS, VAGUE, about_margin

_SUMMED = 5  # numbers of a text that may be parts of a sum, at most
_EXACT_BELOW = 4  # smaller numbers are exact
_DISTANCE_TOLERANCE, _DISTANCE_SHARE = 3, 0.25
_UNSTATED = -1.0  # logarithm of how much less likely a pair is that no wording makes
_COMPARED = 3.0  # of how much likelier one is that a comparison in the text makes


def pair_scores(
    numbers: Sequence[int], unit: str, levels: int, compared: Sequence[Bounds] = ()
) -> Float[np.ndarray, "levels levels"]:
    """What is added to the logarithm of the likelihood of (least, 0 or one more than most).

    Args:
      numbers: of the text.
      compared: ranges that its comparisons state (``compared_bounds``).
      unit: of the attribute, "" for counts.
      levels: numbers that an end can be.
    """
    rows = np.arange(levels)
    is_pair = (rows[:, None] < rows[None]) | (rows[None] == 0)
    scores = np.where(is_pair, _UNSTATED, -np.inf)
    numbers = [int(number) for number in numbers if number < levels]
    pairs = _distances(numbers) if unit else itertools.chain(VAGUE.values(), [(0, 1), (1, 2)], _counts(numbers))
    for score, some in ((0.0, pairs), (_COMPARED, () if unit else _with_both_ends(compared))):
        for least, most in some:
            end = 0 if most is None else int(most) + 1
            if 0 <= least < levels and end < levels:
                scores[int(least), end] = score
    scores[[0, -1], [0, -1]] = 0.0  # no ends, and numbers beyond the table
    return scores


def _counts(numbers: Sequence[int]) -> Iterator[Bounds]:
    distinct = sorted(set(numbers))
    for number in distinct:
        near = about_margin(number)
        yield from _exact(number)
        yield from (NUMBER_BOUNDS[kind](number) for kind in ("at_least", "more_than", "at_most", "fewer_than"))
        yield max(number - near, 0), number + near
    for low, high in itertools.combinations(distinct, 2):
        yield low, high
        if high > low + 1:
            yield from ((low, high - 1), (low + 1, high), (low + 1, high - 1))
    for size in range(2, _SUMMED + 1):
        for some in itertools.combinations(numbers[:_SUMMED], size):
            yield from _exact(sum(some))
            yield sum(some), None


def _with_both_ends(compared: Sequence[Bounds]) -> Iterator[Bounds]:
    """The ranges, and those of a lower and an upper end: "under ten but over five"."""
    yield from compared
    for (least, most), (other_least, other_most) in itertools.permutations(compared, 2):
        if most is None and other_least == 0 and other_most is not None and least <= other_most:
            yield least, other_most


def _exact(number: int) -> Iterator[Bounds]:
    yield number, number
    if number >= _EXACT_BELOW:
        yield number - 1, number + 1


def _distances(numbers: Sequence[int]) -> Iterator[Bounds]:
    for number in set(numbers):
        margin = max(_DISTANCE_TOLERANCE, round(_DISTANCE_SHARE * number))
        yield from ((max(number - margin, 0), number + margin), (number, None), (0, number))
    yield from itertools.combinations(sorted(set(numbers)), 2)
