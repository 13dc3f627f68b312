"""Numbers in texts of all languages: digits and number words."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Int

from scjax.language.grammar.phrasebook import languages, phrasebook

LARGEST = 41
"""Larger numbers count as this one."""

_NO_SPACES = r"[\u3040-\u30ff\u4e00-\u9fff]"  # scripts that write words without spaces


def lowered(text: str) -> str:
    """A text in small letters; as it is if a letter's small form has more characters, which would move the places."""
    lower = text.lower()
    return lower if len(lower) == len(text) else text


def find_numbers(text: str) -> Iterator[tuple[int, int, int]]:
    """(start, end, value) of every digit sequence and number word, the longest first where words overlap."""
    values = _values()
    for match in _pattern().finditer(lowered(text)):
        word = match.group()
        yield match.start(), match.end(), int(word) if word.isdecimal() else values[word]


def token_numbers(text: str, spans: Sequence[tuple[int, int]]) -> Int[np.ndarray, " tokens"]:
    """For every token the number that it is a part of, plus 1, at most ``LARGEST`` + 1; 0 for none.

    Args:
      spans: (start, end) of every token in the text.
    """
    numbers = np.zeros(len(spans), np.int32)
    for start, end, value in find_numbers(text):
        for row, (first, last) in enumerate(spans):
            if first < end and last > start:
                numbers[row] = 1 + min(value, LARGEST)
    return numbers


@functools.cache
def _values() -> dict[str, int]:
    """Number word -> value; of two languages that share a word, English first, it has the value of the first."""
    values: dict[str, int] = {}
    for code in languages():
        for word, value in _entries(phrasebook(code).words["numbers"].items()):
            values.setdefault(word.lower(), value)
    return values


def _entries(items: Iterable[tuple[str, object]]) -> Iterator[tuple[str, int]]:
    for key, content in items:
        if isinstance(content, dict):  # a table for each gender
            yield from _entries(content.items())
        else:
            yield str(content), int(key)


@functools.cache
def _pattern() -> re.Pattern[str]:
    words = sorted(_values(), key=len, reverse=True)
    joined = [word for word in words if re.match(_NO_SPACES, word)]
    spaced = [word for word in words if not re.match(_NO_SPACES, word)]
    alternatives = [r"\d{1,9}", rf"(?<!\w)(?:{'|'.join(map(re.escape, spaced))})(?!\w)", *map(re.escape, joined)]
    return re.compile("|".join(alternatives))
