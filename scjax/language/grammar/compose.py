"""Captions as people write, each with the request that its words make."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from scjax.language.grammar.assembly import Part, assemble
from scjax.language.grammar.noise import capitalize, make_mistakes
from scjax.language.grammar.phrasebook import Phrasebook, languages, phrasebook
from scjax.language.grammar.quantities import StatedQuantity, draw_quantity
from scjax.language.grammar.scene_values import FreeValues, MeasuredValues, ValueSource
from scjax.language.grammar.selection import (
    Statement,
    choose_statements,
    contradicting_statement,
    joint_request,
)
from scjax.language.grammar.styles import PLANS, STYLES, Plan
from scjax.language.grammar.wordings import choose_alternatives, fill, pick

_PREFERRED_SHARE = 0.75  # of phrasings in the preferred register of a plan
_ENGLISH_STYLES = tuple(name for name in STYLES if name != "languages")
_LANGUAGE_SHARE = 0.3  # of texts that are not in English, where nothing is given
_ASIDE_SHARE = 0.3  # of texts with an aside, and of those with one that have another
_REPAIR_SHARE = 0.04  # of spoken counts that are said wrong first
_EMPTY_SHARE = 0.04  # of texts about no scene that ask for nothing


class Composition(NamedTuple):
    """A text and what it asks for.

    Attributes:
      text: as a person could have typed it.
      request: attribute -> request in its normal form: exactly what the words say.
      style: key of ``styles.STYLES``.
      language: code, such as "en".
      contradictions: attributes on which the text contradicts itself; they are not in the request.
    """

    text: str
    request: dict[str, Any]
    style: str
    language: str
    contradictions: tuple[str, ...] = ()


def compose(
    measured: Mapping[str, Any], rng: np.random.Generator, *, style: str | None = None, language: str | None = None
) -> Composition:
    """A text about a scene, which fulfills the request that it makes.

    Args:
      measured: of ``attributes.table.measure_attributes``.
      rng: chooses what is said and how.
      style: key of ``styles.STYLES``; None draws one.
      language: code of a language; None draws one, mostly English.

    Raises:
      ValueError: there is no such style or language, or the style is not one of the language.
    """
    book, name = _book_and_style(style, language, rng)
    return _composition(book, name, MeasuredValues(measured), rng)


def compose_freely(
    rng: np.random.Generator, *, style: str | None = None, language: str | None = None, contradicts: bool = False
) -> Composition:
    """A text about no scene: rare values are as likely as common ones, and numbers are drawn.

    Args:
      rng, style, language: as in ``compose``.
      contradicts: whether the text contradicts itself once, if a contradiction can be worded.

    Raises:
      ValueError: as ``compose``.
    """
    book, name = _book_and_style(style, language, rng)
    return _composition(book, name, FreeValues(rng), rng, contradicts=contradicts)


def _book_and_style(style: str | None, language: str | None, rng: np.random.Generator) -> tuple[Phrasebook, str]:
    if style is not None and style not in STYLES:
        raise ValueError(f"there is no style {style!r}: choose from {', '.join(STYLES)}")
    others = languages()[1:]
    if language is None:
        is_other = style == "languages" or (style is None and others and rng.random() < _LANGUAGE_SHARE)
        language = pick(others, rng) if is_other else "en"
    book = phrasebook(language)
    if style is None:
        style = str(pick(_ENGLISH_STYLES, rng)) if language == "en" else "languages"
    if (style == "languages") == (language == "en"):
        cure = "choose another style for English" if language == "en" else "choose the style 'languages'"
        raise ValueError(f"style {style!r} is none of language {language!r}: {cure}")
    return book, str(style)


def _composition(
    book: Phrasebook, name: str, values: ValueSource, rng: np.random.Generator, *, contradicts: bool = False
) -> Composition:
    style = STYLES[name]
    plan_name = pick([plan for plan in style.plans if plan in book.style], rng)
    plan = PLANS[plan_name]
    least, most = style.size
    number = least + int((most - least + 1) * rng.random() ** 1.5)
    is_empty = bool(book.asides) and isinstance(values, FreeValues) and rng.random() < _EMPTY_SHARE
    statements = [] if is_empty else choose_statements(book, values, plan, style, number, rng)
    request, in_doubt = joint_request(statements), set()
    if contradicts and (found := contradicting_statement(book, FreeValues(rng), plan, statements, rng)):
        statements, in_doubt = [*statements, found[0]], found[1]
        request = {key: value for key, value in joint_request(statements).items() if key not in in_doubt}
    parts = _with_asides(book, plan, _parts(book, plan, statements, rng), rng)
    text = assemble(book, plan_name, parts, rng)
    if plan_name in ("spoken", "slangy", "wish") and rng.random() < 0.6 - style.noise / 2:
        text = capitalize(text)
    text = make_mistakes(text, book, style.noise, rng)
    return Composition(text, request, name, book.code, tuple(sorted(in_doubt)))


def _parts(book: Phrasebook, plan: Plan, statements: list[Statement], rng: np.random.Generator) -> list[Part]:
    voice = plan.voice or pick(list(book.words["voices"]), rng)
    parts = []
    for entry, quantities, _, texts in statements:
        registers = list(texts)
        register = registers[0] if rng.random() < _PREFERRED_SHARE else pick(registers, rng)
        template = pick(texts[register], rng)
        text = fill(book, template, quantities, rng, register=register, voice=voice)
        if plan.voice == "first" and "repairs" in book.style and rng.random() < _REPAIR_SHARE:
            drawn = {slot: _misstated(quantity, rng) for slot, quantity in quantities.items()}
            wrong = {slot: quantity for slot, quantity in drawn.items() if quantity is not None}
            if wrong and len(wrong) == len(drawn):
                first = fill(book, template, wrong, rng, register=register, voice=voice)
                text = f"{first}{pick(book.style['repairs'], rng)}{text}"
        parts.append(Part(text, register, entry.group))
    return parts


def _misstated(quantity: StatedQuantity, rng: np.random.Generator) -> StatedQuantity | None:
    """Another number in place of an exact count; None for other quantities."""
    if quantity.kind != "exact" or quantity.unit:
        return None
    number = quantity.numbers[0]
    return draw_quantity("exact", number + int(pick([-1, 1, 2] if number > 1 else [1, 2], rng)), rng)


def _with_asides(book: Phrasebook, plan: Plan, parts: list[Part], rng: np.random.Generator) -> list[Part]:
    """The parts, in some texts with words between them that ask for nothing; these alone where there are no parts."""
    registers = [register for register in plan.registers if register in book.asides]
    parts = list(parts)
    while registers and (not parts or rng.random() < _ASIDE_SHARE):
        register = pick(registers, rng)
        aside = choose_alternatives(pick(book.asides[register], rng), rng).strip()
        parts.insert(int(rng.integers(len(parts) + 1)), Part(aside, register, "aside"))
    return parts
