"""What a text says of its numbers, such as "fewer than three": by the wordings of the grammar in all languages."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from scjax.language.attributes.base import Bounds
from scjax.language.grammar.phrasebook import languages, phrasebook
from scjax.language.grammar.quantities import NUMBER_BOUNDS
from scjax.language.reader.numbers import find_numbers, lowered

_NUMBER, _NOUN = "#", "~"
_NEAR = 24  # characters between a number and what follows its noun


class _Wording(NamedTuple):
    """A comparison around a number: what stands before it, and what follows it or its noun."""

    kind: str
    before: str
    after: str
    has_noun: bool


def compared_bounds(text: str) -> Iterator[Bounds]:
    """The range of every number of a text that a comparison stands at; the longest wording counts."""
    lower = lowered(text)
    wordings, phrases = _wordings()
    for phrase, bounds in phrases.items():
        if re.search(rf"(?<!\w){re.escape(phrase)}(?!\w)", lower):
            yield bounds
    for start, end, value in find_numbers(text):
        before, after = lower[:start].rstrip(), lower[end:]
        fits = [one for one in wordings if _ends_with(before, one.before) and _goes_on(after, one)]
        if fits:
            kind = max(fits, key=lambda one: len(one.before) + len(one.after)).kind
            yield NUMBER_BOUNDS[kind](value)


def _ends_with(text: str, words: str) -> bool:
    if not text.endswith(words):
        return False
    rest = text[: len(text) - len(words)]
    return not words or not (rest[-1:].isalnum() and words[0].isalnum() and words.isascii())


def _goes_on(text: str, wording: _Wording) -> bool:
    if not wording.after:
        return True
    if not wording.has_noun:
        return _begins_with(text.lstrip(), wording.after)
    place = text.find(wording.after, 0, _NEAR + len(wording.after))
    between = text[: max(place, 0)]
    return place >= 0 and not re.search(r"[\d,.;:!?、。]", between) and _begins_with(text[place:], wording.after)


def _begins_with(text: str, words: str) -> bool:
    return text.startswith(words) and not (text[len(words) :][:1].isalnum() and words.isascii())


@functools.cache
def _wordings() -> tuple[tuple[_Wording, ...], Mapping[str, Bounds]]:
    """Wordings around a number, and whole phrases such as "at least a dozen" with their ranges."""
    wordings, phrases = set[_Wording](), dict[str, Bounds]()
    for code in languages():
        words = phrasebook(code).words
        for table in (words["quantities"], words["symbols"]):
            for key, content in table.items():
                kind, _, number = key.partition(" ")
                for template in _templates(content) if kind in NUMBER_BOUNDS else ():
                    text = template.lower()
                    if text.count(_NUMBER) == 1:
                        before, after = text.split(_NUMBER)
                        shown = after.replace(_NOUN, "").strip()
                        if _NOUN not in before and (before.strip() or shown):
                            wordings.add(_Wording(kind, before.strip(), shown, _NOUN in after and bool(shown)))
                    elif number and _NUMBER not in text and _NOUN not in text:
                        phrases[text] = NUMBER_BOUNDS[kind](int(number))
    return tuple(sorted(wordings)), phrases


def _templates(content: Any) -> Iterator[str]:
    if isinstance(content, str):
        yield content
    else:
        for one in content.values() if isinstance(content, Mapping) else content:
            yield from _templates(one)
