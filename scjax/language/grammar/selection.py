"""Which attributes a text speaks of, and with which phrasings."""

from __future__ import annotations

import functools
from collections import defaultdict
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from scjax.language.attributes.contradictions import find_clashes, find_contradictions
from scjax.language.attributes.table import ATTRIBUTES
from scjax.language.grammar.phrasebook import GROUPS, Entry, Phrasebook, phrasebook
from scjax.language.grammar.quantities import StatedQuantity
from scjax.language.grammar.scene_values import MeasuredValues, ValueSource, fitting_quantities, stated_request
from scjax.language.grammar.styles import Plan, Style
from scjax.language.grammar.wordings import usable_templates

_WEIGHTS = {
    **{"layout": 6.0, "vehicles": 4.0, "event": 5.0, "signal": 3.0, "ahead": 2.5, "pedestrians": 2.5},
    **{"not_layout": 0.5, "compare": 0.4, "where": 0.8, "ego_lane_index": 0.7, "ego_manoeuvre": 1.0},
}
"""How likely people speak of an attribute; 1.5 for the others."""
_PLAIN_WEIGHT = 1.5
_JOINT_SHARE = 0.4  # of the weight, for every further attribute of a phrasing
_ENTRIES_POWER = 0.3  # topics with many entries are spoken of more often
_TRIES = 3  # entries of a topic that are tried


class Statement(NamedTuple):
    """An entry with its slots filled.

    Attributes:
      entry: its phrasings.
      quantities: slot -> quantity.
      request: that it makes, in its normal form.
      texts: register of the plan -> templates that can state it; at least one.
    """

    entry: Entry
    quantities: Mapping[str, StatedQuantity]
    request: Mapping[str, Any]
    texts: Mapping[str, list[str]]


def choose_statements(
    book: Phrasebook, values: ValueSource, plan: Plan, style: Style, number: int, rng: np.random.Generator
) -> list[Statement]:
    """Up to ``number`` statements that ``values`` allow and that do not contradict each other.

    They are in the order in which a text makes them, road first.
    """
    topics = _topics(book.code, plan, isinstance(values, MeasuredValues))
    names = list(topics)
    weights = np.array([_weight(topic) * len(entries) ** _ENTRIES_POWER for topic, entries in topics.items()])
    order = np.argsort(rng.exponential(1.0, len(names)) / weights)
    chosen: list[Statement] = []
    for is_last_resort in (False, True):
        for row in order:
            if len(chosen) >= (1 if is_last_resort else number):
                break
            statement = _statement(book, plan, topics[names[row]], values, rng)
            if statement is None:
                continue
            likelihood = 1.0 if is_last_resort else style.focus(statement.request, statement.quantities)
            if rng.random() < likelihood and _is_new(chosen, statement):
                chosen.append(statement)
    return sorted(chosen, key=lambda statement: GROUPS.index(statement.entry.group))


def contradicting_statement(
    book: Phrasebook, values: ValueSource, plan: Plan, chosen: list[Statement], rng: np.random.Generator
) -> tuple[Statement, set[str]] | None:
    """A statement that contradicts the chosen ones, with all attributes that are then in doubt, or None."""
    topics = list(_topics(book.code, plan, False).values())
    present = joint_request(chosen)
    for row in rng.permutation(len(topics)):
        statement = _statement(book, plan, topics[row], values, rng)
        if statement is None:
            continue
        both = {**present, **statement.request}
        names = {name for pair in find_contradictions(both) for name in pair}
        names |= set(find_clashes(present, statement.request))
        if names:
            return statement, names
    return None


def joint_request(statements: list[Statement]) -> dict[str, Any]:
    """The request that statements make together; values of sets are gathered."""
    request: dict[str, Any] = {}
    for statement in statements:
        for name, value in statement.request.items():
            if ATTRIBUTES[name].kind == "set":
                value = ATTRIBUTES[name].check([*request.get(name, ()), *value])
            request[name] = value
    return request


@functools.cache
def _weight(topic: tuple[str, ...]) -> float:
    weights = [_WEIGHTS.get(name, _PLAIN_WEIGHT) for name in topic]
    return sum(weights) / len(weights) * _JOINT_SHARE ** (len(weights) - 1)


@functools.cache
def _topics(code: str, plan: Plan, of_scene: bool) -> dict[tuple[str, ...], list[Entry]]:
    """Entries that a plan has words for, by the attributes that they speak of."""
    topics = defaultdict(list)
    for entry in phrasebook(code).entries:
        if not (of_scene and entry.loose) and any(register in entry.texts for register in plan.registers):
            topics[entry.names].append(entry)
    return topics


def _statement(
    book: Phrasebook, plan: Plan, entries: list[Entry], values: ValueSource, rng: np.random.Generator
) -> Statement | None:
    units = tuple(book.words["units"])
    for row in rng.permutation(len(entries))[: max(_TRIES, len(entries) // 2)]:
        entry = entries[row]
        kinds = [kind for kind in entry.kinds if kind in book.words["quantities"]]
        quantities = fitting_quantities(entry, kinds, values, units, rng)
        if quantities is None:
            continue
        texts = {
            register: templates
            for register in plan.registers
            if (templates := usable_templates(book, entry.texts.get(register, ()), quantities))
        }
        if texts:
            return Statement(entry, quantities, stated_request(entry, quantities), texts)
    return None


def _is_new(chosen: list[Statement], statement: Statement) -> bool:
    """Whether a statement repeats no attribute of the chosen ones and contradicts none."""
    present = joint_request(chosen)
    for name, value in statement.request.items():
        if name in present and not (ATTRIBUTES[name].kind == "set" and not set(value) & set(present[name])):
            return False
    return not find_contradictions(joint_request([*chosen, statement]))
