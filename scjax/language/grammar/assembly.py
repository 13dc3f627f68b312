"""Phrasings put together: keywords, sentences, wishes, sections; the words between them are in ``style.toml``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from scjax.language.grammar.noise import capitalize
from scjax.language.grammar.phrasebook import Phrasebook
from scjax.language.grammar.wordings import choose_alternatives, pick

_ROAD_GROUPS = ("road", "lanes", "signals")


class Part(NamedTuple):
    """A phrasing in words, its register and the group of attributes that it is about."""

    text: str
    register: str
    group: str


def assemble(book: Phrasebook, plan: str, parts: Sequence[Part], rng: np.random.Generator) -> str:
    """The parts as one text, by a plan of ``styles.PLANS``."""
    style = book.style
    if plan in ("keys", "test"):
        text = _join([part.text for part in parts], pick(style[plan]["separators"], rng), style[plan], rng)
    elif plan == "wish":
        text = _wish(style, parts, rng)
    elif plan == "sections":
        text = _sections(style["sections"], parts, rng)
    elif plan == "paragraph":
        text = _paragraph(style, parts, rng)
    else:
        text = _spoken(style, style[plan], parts, rng)
    return choose_alternatives(text, rng)


def _join(texts: Sequence[str], separator: str, table: Any, rng: np.random.Generator) -> str:
    return _in_pattern(separator.join(texts), table, rng)


def _in_pattern(text: str, table: Any, rng: np.random.Generator) -> str:
    """``text`` in one of the patterns of a table; half of the time in the first one."""
    patterns = table["patterns"]
    return (patterns[0] if rng.random() < 0.5 else pick(patterns, rng)).replace("{}", text)


def _listed(texts: Sequence[str], style: Any) -> str:
    if len(texts) == 1:
        return texts[0]
    return f"{style['comma'].join(texts[:-1])}{style['and']}{texts[-1]}"


def _split(parts: Sequence[Part], *registers: str) -> tuple[list[str], list[str]]:
    """Texts of some registers, and the others."""
    inside = [part.text for part in parts if part.register in registers]
    return inside, [part.text for part in parts if part.register not in registers]


def _wish(style: Any, parts: Sequence[Part], rng: np.random.Generator) -> str:
    """ "give me HEAD with NOUN and NOUN, CLAUSE"."""
    table = style["wish"]
    heads = [part.text for part in parts if part.register == "noun" and part.group == "road"]
    nouns = [part.text for part in parts if part.register == "noun" and part.group != "road"]
    clauses = [part.text for part in parts if part.register != "noun"]
    head = heads[0] if heads else pick(table["heads"], rng)
    nouns = [*heads[1:], *nouns]
    text = f"{head}{pick(table['with'], rng)}{_listed(nouns, style)}" if nouns else head
    text = _in_pattern(text, table, rng)
    stop = " " if text.endswith(tuple(table["marks"])) else style["stop"]
    return stop.join([text, style["stop"].join(map(capitalize, clauses))]) if clauses else text


def _spoken(style: Any, table: Any, parts: Sequence[Part], rng: np.random.Generator) -> str:
    """Clauses with words between them, then the nouns."""
    nouns, clauses = _split(parts, "noun")
    text = ""
    for number, clause in enumerate(clauses):
        if not number:
            text = clause
            continue
        between = pick(table["connectors"], rng)
        text += between + (capitalize(clause) if between == style["stop"] else clause)
    if nouns and text:
        text += pick(table["with"], rng).replace("{}", _listed(nouns, style))
    elif nouns:
        text = pick(table["nouns"], rng).replace("{}", _listed(nouns, style))
    return _in_pattern(text, table, rng)


def _sections(table: Any, parts: Sequence[Part], rng: np.random.Generator) -> str:
    """ "ROAD & CONTROL: ... AGENTS: ..."."""
    separator = pick(table["separators"], rng)
    road = [part.text for part in parts if part.group in _ROAD_GROUPS]
    agents = [part.text for part in parts if part.group not in _ROAD_GROUPS]
    texts = {
        name: capitalize(separator.join(texts)) if texts else pick(table["nothing"], rng)
        for name, texts in (("{road}", road), ("{agents}", agents))
    }
    text = pick(table["patterns"], rng)
    for name, value in texts.items():
        text = text.replace(name, value)
    return text


def _paragraph(style: Any, parts: Sequence[Part], rng: np.random.Generator) -> str:
    """Sentences of the third person; nouns of one part of the scene share one."""
    table = style["paragraph"]
    sentences = []
    for is_road in (True, False):
        nouns, facts = _split([part for part in parts if (part.group in _ROAD_GROUPS) == is_road], "noun")
        if nouns:
            pattern = pick(table["road" if is_road else "agents"], rng)
            sentences.append(pattern.replace("{}", _listed(nouns, style)))
        sentences += facts
    return style["stop"].join(map(capitalize, sentences)) + style["stop"].rstrip()
