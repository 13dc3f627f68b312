"""What prompts ask for, as attributes of the conditions."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from scjax.generate.conditions import Condition
from scjax.generate.model import Model
from scjax.generate.prompt_reader import PromptReader, load_reader
from scjax.language.attributes.contradictions import find_contradictions

_AGENTS = ("vehicles", "pedestrians", "cyclists", "static")


def read_prompts(conditions: Sequence[Condition], model: Model, reader: PromptReader | None = None) -> list[Condition]:
    """The conditions with what their prompts ask for as attributes; given attributes win over read ones.

    Negative prompts become negative attributes. Conditions without a prompt stay as they are, and all of them do if the
    model's network reads prompts itself. Of parts of a prompt that contradict each other none is taken.

    Args:
      reader: by default the one that ships.

    Raises:
      ValueError: the reader's encoder cannot be had.
    """
    return read_requests(conditions, reader) if reads_requests(model) else list(conditions)


def read_requests(conditions: Sequence[Condition], reader: PromptReader | None = None) -> list[Condition]:
    """As ``read_prompts``, whatever the model."""
    prompts = list(dict.fromkeys(text for one in conditions for text in one.prompts.values()))
    if not prompts:
        return list(conditions)
    requests = dict(zip(prompts, _requests(prompts, reader or load_reader()), strict=True))
    return [_with_requests(one, requests) for one in conditions]


def reads_requests(model: Model) -> bool:
    """Whether a model takes prompts as requests for attributes."""
    if model.reads_prompts or "denoiser" not in model.components:
        return model.reads_prompts
    return bool(model.denoiser.config.attributes) and not model.text_encoder


def prompt_warnings(condition: Condition, reader: PromptReader | None = None) -> list[str]:
    """Sentences about parts of a prompt that will not come true.

    Nothing is understood of it, parts contradict each other, or it asks for more agents than ``num_agents`` allows.
    """
    if condition.prompt is None:
        return []
    request = (reader or load_reader())([condition.prompt])[0].request
    short = textwrap.shorten(condition.prompt, 60, placeholder=" ...")
    if not request:
        return [f"nothing that a scene can show is understood of {short!r}"]
    warnings = [
        f"{short!r} contradicts itself in {one} and {other}: neither is taken"
        for one, other in find_contradictions(request)
    ]
    least = sum(int(request.get(name, (0, None))[0]) for name in _AGENTS)
    if condition.num_agents is not None and least + 1 > condition.num_agents:
        warnings.append(
            f"{short!r} asks for {least} agents or more besides the ego, but the number of agents is given as "
            f"{condition.num_agents}: the given number is taken"
        )
    return warnings


def _requests(prompts: Sequence[str], reader: PromptReader) -> list[dict[str, Any]]:
    return [_without_contradictions(reading.request, kept=()) for reading in reader(prompts)]


def _with_requests(condition: Condition, requests: Mapping[str, dict[str, Any]]) -> Condition:
    changes = {}
    for prompt, name in ((condition.prompt, "attributes"), (condition.negative_prompt, "negative_attributes")):
        if prompt is not None:
            given = getattr(condition, name)
            changes[name] = _without_contradictions({**requests[prompt], **given}, kept=tuple(given))
    return dataclasses.replace(condition, **changes)


def _without_contradictions(request: dict[str, Any], kept: Sequence[str]) -> dict[str, Any]:
    dropped = {name for pair in find_contradictions(request) for name in pair} - set(kept)
    return {name: value for name, value in request.items() if name not in dropped}
