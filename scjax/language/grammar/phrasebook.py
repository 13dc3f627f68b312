"""Phrasings of one language: hand-written templates and words, read from the files of ``phrases/``.

A folder per language holds ``words.toml`` (nouns, quantities, numbers), ``style.toml`` (how phrasings are put
together), ``asides.toml`` (texts by register that ask for nothing) and a file per group of attributes, such as

    [[phrase]]
    asks = { ahead = "n" }                        # attribute -> value, or the slot that states it
    said = ["there [is|are] {n car} in front of me"]
    key = ["{n car} ahead"]

A template has slots ``{n car}`` (a quantity with a noun), ``{n}`` (a quantity alone), ``{me}`` (a word by voice),
``[is|are]`` (forms that agree with the quantity) and ``<big|huge>`` (free alternatives).
"""

from __future__ import annotations

import dataclasses
import functools
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scjax.language.attributes.base import Bounds
from scjax.language.attributes.table import ATTRIBUTES
from scjax.language.grammar.quantities import KINDS

FOLDER = Path(__file__).parent / "phrases"
GROUPS = ("road", "lanes", "signals", "ego", "relations", "agents", "events")
"""Files of phrasings, in the order in which a text speaks of them."""
REGISTERS = ("key", "noun", "said", "fact", "test", "slang")
"""Forms of phrasings: keywords, noun phrases, first person, third person, test language, slang."""
_REGISTER_CURE = f"write one of {', '.join(REGISTERS)}"
SLOTS = {"n": "count", "m": "count", "i": "index", "nth": "ordinal", "gap": "distance"}
"""Slot -> what it states. Counts are quantities; an index or ordinal is one number."""
LANE_KINDS = ("exact", "exactly", "at_least", "at_most", "several", "couple")
_DISTANCE_KINDS = ("exact", "at_least", "at_most")


@dataclasses.dataclass(frozen=True)
class Entry:
    """Phrasings with one meaning.

    Attributes:
      group: of attributes, one of ``GROUPS``.
      values: attribute -> request that the words make.
      slots: slot -> attributes whose quantity it states.
      kinds: of the quantities that fit its slots.
      texts: register -> templates.
      loose: the words tie attributes together ("a truck ahead") beyond what the request states; not for captions.
    """

    group: str
    values: Mapping[str, Any]
    slots: Mapping[str, tuple[str, ...]]
    kinds: tuple[str, ...]
    texts: Mapping[str, tuple[str, ...]]
    loose: bool

    @functools.cached_property
    def names(self) -> tuple[str, ...]:
        """All attributes that it speaks of."""
        return (*self.values, *(name for names in self.slots.values() for name in names))


@dataclasses.dataclass(frozen=True)
class Noun:
    """Forms of a noun by number, and its gender."""

    forms: tuple[str, ...]
    gender: str


@dataclasses.dataclass(frozen=True)
class Phrasebook:
    """Everything that the grammar knows of one language."""

    code: str
    entries: tuple[Entry, ...]
    nouns: Mapping[str, tuple[Noun, ...]]
    words: Mapping[str, Any]
    style: Mapping[str, Any]
    asides: Mapping[str, list[str]]

    @property
    def templates(self) -> list[str]:
        """All phrasings."""
        return [text for entry in self.entries for texts in entry.texts.values() for text in texts]


@functools.cache
def languages() -> tuple[str, ...]:
    """Codes of all languages, English first."""
    codes = sorted(path.parent.name for path in FOLDER.glob("*/words.toml"))
    return ("en", *(code for code in codes if code != "en"))


@functools.cache
def phrasebook(code: str) -> Phrasebook:
    """The phrasings of a language.

    Raises:
      ValueError: no such language; or a file that breaks the rules above, naming it and the entry.
    """
    folder = FOLDER / code
    if code not in languages():
        raise ValueError(f"there are no phrasings in {code!r}: choose from {', '.join(languages())}")
    words = _read(folder / "words.toml")
    entries = [
        _entry(group, content, f"{code}/{group}.toml, phrase {number}")
        for group in GROUPS
        if (folder / f"{group}.toml").is_file()
        for number, content in enumerate(_read(folder / f"{group}.toml")["phrase"], 1)
    ]
    nouns = {name: tuple(map(_noun, forms)) for name, forms in words["nouns"].items()}
    asides = _read(folder / "asides.toml") if (folder / "asides.toml").is_file() else {}
    if unknown := set(asides) - set(REGISTERS):
        raise ValueError(f"{code}/asides.toml: unknown fields {', '.join(sorted(unknown))}: {_REGISTER_CURE}")
    return Phrasebook(code, tuple(entries), nouns, words, _read(folder / "style.toml"), asides)


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path} is no TOML ({error}): mend it") from error


def _noun(text: str) -> Noun:
    forms, _, gender = text.partition(" / ")
    return Noun(tuple(forms.split("|")), gender)


def _entry(group: str, content: dict[str, Any], place: str) -> Entry:
    content = dict(content)
    asks, kinds, loose = content.pop("asks", {}), content.pop("kinds", None), content.pop("loose", False)
    if unknown := set(content) - set(REGISTERS):
        raise ValueError(f"{place}: unknown fields {', '.join(sorted(unknown))}: {_REGISTER_CURE}")
    values: dict[str, Any] = {}
    slots: dict[str, tuple[str, ...]] = {}
    for name, value in asks.items():
        if name not in ATTRIBUTES:
            raise ValueError(f"{place}: there is no attribute {name!r}: see docs/attributes.md")
        if ATTRIBUTES[name].kind == "range" and isinstance(value, str):
            if value not in SLOTS:
                raise ValueError(f"{place}: {name} = {value!r}: write a range or one of {', '.join(SLOTS)}")
            slots[value] = (*slots.get(value, ()), name)
        else:
            values[name] = ATTRIBUTES[name].check(_open(value))
    if unknown := set(kinds or ()) - set(KINDS):
        raise ValueError(f"{place}: kinds {', '.join(sorted(unknown))}: write some of {', '.join(KINDS)}")
    texts = {register: tuple(content[register]) for register in REGISTERS if content.get(register)}
    if not asks or not texts:
        raise ValueError(f"{place}: asks or texts are missing")
    if "layout" in asks:
        group = "road"  # it is what the road is, whatever else it says
    return Entry(group, values, slots, tuple(kinds or _kinds(slots)), texts, loose)


def _kinds(slots: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    names = [name for names in slots.values() for name in names]
    if "gap" in slots:
        return _DISTANCE_KINDS
    return LANE_KINDS if any(name.startswith("lanes_") for name in names) else KINDS


def _open(value: Any) -> Any:
    """A range with None where TOML writes inf."""
    if not isinstance(value, list) or not value or isinstance(value[0], str):
        return value
    bounds: Bounds = (value[0], None if value[1] == math.inf else value[1])
    return bounds
