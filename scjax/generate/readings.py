"""What prompts ask for, as attributes of the conditions."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.prompt_reader import PromptReader, load_reader
from scjax.language.attributes.contradictions import find_contradictions

_AGENTS = ("vehicles", "pedestrians", "cyclists", "static")


class PromptReadings(NamedTuple):
    """What was read of the prompts of some conditions.

    Attributes:
      conditions: with what their prompts ask for as attributes.
      warnings: for every condition, sentences about parts of its prompt that will not come true.
      likely: for every condition, attributes that its prompt may ask for too. They go with its attributes, and decide
        between outlines that show these.
    """

    conditions: list[Condition]
    warnings: list[list[str]]
    likely: list[dict[str, Any]]


def read_prompts(conditions: Sequence[Condition], model: Model, reader: PromptReader | None = None) -> PromptReadings:
    """The conditions with what their prompts ask for as attributes; given attributes win over read ones.

    Negative prompts become negative attributes. Conditions without a prompt stay as they are, and all of them do if the
    model's network reads prompts itself. Of parts of a prompt that contradict each other none is taken.

    Args:
      reader: by default the one that ships.

    Raises:
      ValueError: the reader's encoder cannot be had.
    """
    if reads_requests(model):
        return read_requests(conditions, reader)
    return _nothing_read(conditions)


def read_requests(conditions: Sequence[Condition], reader: PromptReader | None = None) -> PromptReadings:
    """As ``read_prompts``, whatever the model."""
    prompts = list(dict.fromkeys(text for one in conditions for text in one.prompts.values()))
    if not prompts:
        return _nothing_read(conditions)
    requests = dict(zip(prompts, _requests(prompts, reader or load_reader()), strict=True))
    read = [_with_requests(one, requests) for one in conditions]
    return PromptReadings(
        read,
        [[] if one.prompt is None else _warnings(one, requests[one.prompt]) for one in conditions],
        [{} if one.prompt is None else _likely(one, requests[one.prompt]) for one in read],
    )


def _nothing_read(conditions: Sequence[Condition]) -> PromptReadings:
    return PromptReadings(list(conditions), [[] for _ in conditions], [{} for _ in conditions])


def reads_requests(model: Model) -> bool:
    """Whether a model takes prompts as requests for attributes."""
    if model.reads_prompts or "denoiser" not in model.components:
        return model.reads_prompts
    return bool(model.denoiser.config.attributes) and not model.text_encoder


def prompt_warnings(condition: Condition, reader: PromptReader | None = None) -> list[str]:
    """Sentences about parts of a prompt that will not come true.

    Nothing is understood of it, parts contradict each other, or it asks for more agents than ``num_agents`` allows.
    """
    return read_requests([condition], reader).warnings[0]


class _PromptRequest(NamedTuple):
    """What one prompt asks for: attributes, pairs of them that cannot both hold, and further attributes that it may."""

    attributes: dict[str, Any]
    contradictions: list[tuple[str, str]]
    likely: Mapping[str, Any]


def _requests(prompts: Sequence[str], reader: PromptReader) -> list[_PromptRequest]:
    return [_PromptRequest(one.request, find_contradictions(one.request), one.likely) for one in reader(prompts)]


def _warnings(condition: Condition, request: _PromptRequest) -> list[str]:
    short = textwrap.shorten(condition.prompt or "", 60, placeholder=" ...")
    if not request.attributes:
        return [f"nothing that a scene can show is understood of {short!r}"]
    warnings = [
        f"{short!r} contradicts itself in {one} and {other}: neither is taken" for one, other in request.contradictions
    ]
    least = sum(int(request.attributes.get(name, (0, None))[0]) for name in _AGENTS)
    if condition.num_agents is not None and least + 1 > condition.num_agents:
        warnings.append(
            f"{short!r} asks for {least} agents or more besides the ego, but the number of agents is given as "
            f"{condition.num_agents}: the given number is taken"
        )
    return warnings


def _with_requests(condition: Condition, requests: Mapping[str, _PromptRequest]) -> Condition:
    changes = {}
    for prompt, name in ((condition.prompt, "attributes"), (condition.negative_prompt, "negative_attributes")):
        if prompt is not None:
            given = getattr(condition, name)
            read = _without(requests[prompt].attributes, requests[prompt].contradictions)
            request = {**read, **given}
            changes[name] = _without(request, find_contradictions(request), kept=tuple(given))
    return dataclasses.replace(condition, **changes)


def _likely(condition: Condition, request: _PromptRequest) -> dict[str, Any]:
    """Attributes that the prompt of a condition may ask for besides those of the condition, and that go with them."""
    known = {**condition.negative_attributes, **request.attributes, **condition.attributes}
    more = {name: value for name, value in request.likely.items() if name not in known}
    together = {**condition.attributes, **more}
    fitting = _without(together, find_contradictions(together), kept=tuple(condition.attributes))
    return {name: value for name, value in fitting.items() if name in more}


def _without(
    request: Mapping[str, Any], contradictions: Sequence[tuple[str, str]], kept: Sequence[str] = ()
) -> dict[str, Any]:
    dropped = {name for pair in contradictions for name in pair} - set(kept)
    return {name: value for name, value in request.items() if name not in dropped}
