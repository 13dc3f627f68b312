"""Words for quantities, and templates with their slots filled."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from scjax.language.grammar.phrasebook import SLOTS, Noun, Phrasebook
from scjax.language.grammar.quantities import StatedQuantity

_ALTERNATIVES = re.compile(r"<([^<>]*\|[^<>]*)>")
_SLOT = re.compile(r"\{(\w+)(?::(\w+))?(?: (\w+))?\}")
_FORMS = re.compile(r"\[(?:(\w+):)?([^\[\]]*\|[^\[\]]*)\]")
_DIGIT_SHARE = {"key": 0.7, "test": 0.75, "slang": 0.6, "noun": 0.35, "said": 0.3, "fact": 0.25}
"""Share of numbers written in digits, by register."""
_SYMBOL_SHARE = 0.6
_SYMBOL_REGISTERS = ("key", "test")  # those that write "min." and ">="
_SPEEDS = {"slow": (4, 13), "middle": (20, 41), "quick": (60, 131)}  # km/h
_MILE = 1.609  # km


def fill(
    book: Phrasebook,
    template: str,
    quantities: Mapping[str, StatedQuantity],
    rng: np.random.Generator,
    *,
    register: str,
    voice: str,
) -> str:
    """A template in words.

    Args:
      quantities: slot -> quantity that it states.
      register: key of ``Entry.texts`` that holds the template.
      voice: key of the "voices" in ``words.toml``.

    Raises:
      ValueError: the template names a slot, noun or word that the language does not have.
    """
    text = choose_alternatives(template, rng)
    text = _FORMS.sub(lambda match: _agreeing(book, match, quantities), text)
    text = _SLOT.sub(lambda match: _slot_text(book, match, quantities, rng, register, voice), text)
    for wrong, right in book.words.get("corrections", {}).items():
        text = text.replace(wrong, right)
    return text


def usable_templates(book: Phrasebook, templates: Sequence[str], quantities: Mapping[str, StatedQuantity]) -> list[str]:
    """Templates that can state the quantities: one without a noun states few kinds in some languages."""
    kinds = book.words.get("bare_kinds")
    if kinds is None or all(quantity.kind in kinds for quantity in quantities.values()):
        return list(templates)
    return [text for text in templates if all(quantities[slot].kind in kinds for slot in _bare_slots(text))]


def _bare_slots(template: str) -> list[str]:
    return [slot for slot, _, noun in _SLOT.findall(template) if not noun and SLOTS.get(slot) == "count"]


def choose_alternatives(text: str, rng: np.random.Generator) -> str:
    """``text`` with one word of every ``<a|b>``."""

    def choose(match: re.Match[str]) -> str:
        return pick(match.group(1).split("|"), rng)

    while _ALTERNATIVES.search(text):
        text = _ALTERNATIVES.sub(choose, text)
    return text


def pick(choices: Any, rng: np.random.Generator) -> Any:
    """One of a sequence."""
    return choices[int(rng.integers(len(choices)))]


def _agreeing(book: Phrasebook, match: re.Match[str], quantities: Mapping[str, StatedQuantity]) -> str:
    forms = match.group(2).split("|")
    slot = match.group(1) or next(iter(quantities))
    return forms[min(_form(book, quantities[slot]), len(forms) - 1)]


def _form(book: Phrasebook, quantity: StatedQuantity) -> int:
    """Index of the form of nouns and verbs beside a quantity."""
    special = book.words.get("forms_of_kinds", {})
    if not quantity.numbers:
        return special.get(quantity.kind, 0 if quantity.kind == "one" else book.words["many_form"])
    return number_form(book.words["plural"], quantity.numbers[-1])


def number_form(rule: str, number: int) -> int:
    """Index of a noun's form beside a number, by the rule of a language."""
    if rule == "arabic":
        return 0 if number == 1 else 1 if number == 2 else 2 if 3 <= number % 100 <= 10 else 3
    if rule == "none":
        return 0
    return 0 if number == 1 or (rule == "french" and number == 0) else 1


def _slot_text(
    book: Phrasebook,
    match: re.Match[str],
    quantities: Mapping[str, StatedQuantity],
    rng: np.random.Generator,
    register: str,
    voice: str,
) -> str:
    slot, case, noun = match.groups()
    if slot in book.words["voices"][voice]:
        return pick(book.words["voices"][voice][slot], rng)
    if slot in _SPEEDS:
        return _speed(book, slot, rng)
    quantity = quantities[slot]
    if SLOTS[slot] == "distance":
        return _distance(book, quantity, rng, register, is_plain=case == "plain")
    if SLOTS[slot] == "index":
        return str(quantity.numbers[0])
    if SLOTS[slot] == "ordinal":
        ordinals = book.words["ordinals"]
        return ordinals[min(quantity.numbers[0], len(ordinals)) - 1]
    choice = Noun((), case or "") if noun is None else pick(book.nouns[noun], rng)
    gender = choice.gender if case is None or noun is None else f"{choice.gender}.{case}"
    words = _quantity_words(book, quantity, rng, gender, register, is_bare=noun is None)
    form = choice.forms[min(_form(book, quantity), len(choice.forms) - 1)] if choice.forms else ""
    if words == "a ~" and form[:1] in tuple("aeiou"):
        words = "an ~"
    return " ".join(words.replace("~", form).split()) if book.words["spaces"] else words.replace("~", form)


def _quantity_words(
    book: Phrasebook, quantity: StatedQuantity, rng: np.random.Generator, gender: str, register: str, *, is_bare: bool
) -> str:
    """Words with "~" where the noun belongs."""
    kind = quantity.kind
    tables, symbols = book.words["quantities"], book.words["symbols"]
    takes_special = not is_bare or book.words["plural"] == "none"
    special = f"{kind} {quantity.numbers[0]}" if quantity.numbers and takes_special else ""
    table = tables.get(special) or tables[kind]
    takes_symbol = special not in tables and not (is_bare and kind == "exact")
    if takes_symbol and register in _SYMBOL_REGISTERS and kind in symbols and rng.random() < _SYMBOL_SHARE:
        table = symbols[kind]
    in_digits = rng.random() < _DIGIT_SHARE[register]
    text = pick(_by_gender(table, gender), rng)
    for number in quantity.numbers:
        text = text.replace("#", number_text(book, number, gender, in_digits), 1)
    return text if "~" in text else f"{text}{' ' if book.words['spaces'] else ''}~"


def _by_gender(table: Any, gender: str) -> Any:
    """The part of a table for a gender ("f.acc"), else for its first letter, else for all."""
    if not isinstance(table, Mapping):
        return table
    for key in (gender, gender.partition(".")[0], "other"):
        if key in table:
            return table[key]
    return next(iter(table.values()))


def number_text(book: Phrasebook, number: int, gender: str, in_digits: bool) -> str:
    """A number in words where the language file has one, else in digits."""
    gendered = book.words.get("gendered", {}).get(str(number))
    words = book.words["numbers"]
    if gendered is not None and not in_digits:
        return _by_gender(gendered, gender)
    if not isinstance(next(iter(words.values())), str):
        words = _by_gender(words, gender)
    if in_digits or str(number) not in words:
        return str(number)
    return words[str(number)]


def _distance(
    book: Phrasebook, quantity: StatedQuantity, rng: np.random.Generator, register: str, *, is_plain: bool
) -> str:
    measure = pick(book.words["units"][quantity.unit], rng)
    in_digits = rng.random() < _DIGIT_SHARE[register] + 0.2 or "#m" in measure
    in_digits = in_digits or bool(book.words.get("units_in_digits"))
    measure = measure.replace("#", number_text(book, quantity.numbers[0], "", in_digits))
    return measure if is_plain else pick(book.words["distances"][quantity.kind], rng).replace("#", measure)


def _speed(book: Phrasebook, slot: str, rng: np.random.Generator) -> str:
    speed = int(rng.integers(*_SPEEDS[slot]))
    unit = pick(book.words["speed_units"], rng)
    size = _MILE if "mph" in unit or "miles" in unit else 3.6 if unit.endswith("m/s") else 1.0
    step = 1 if speed < 15 or size == 3.6 else 5
    return unit.replace("#", str(max(1, round(speed / size / step) * step)))
