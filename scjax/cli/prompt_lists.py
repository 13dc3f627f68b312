"""The prompts of a command: lists in a file, one JSON object a line, with "id" and "prompt"; and what they ask for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from scjax.cli.output import say

if TYPE_CHECKING:
    from scjax.generate.components import Model
    from scjax.generate.conditions import Condition

CHUNK = 128
"""Prompts that are sampled together, in batches by size. Scenes depend on the place of their prompt in the file."""

_ID = re.compile(r"\w[\w.-]{0,99}")
_CURE = 'write one object a line, such as {"id": "a1", "prompt": "a roundabout"}'


class ListedPrompt(NamedTuple):
    """A prompt of a list, and the name of its folder; no prompt where a picture says all, or nothing is requested."""

    id: str
    prompt: str | None


class _Line(msgspec.Struct):
    id: str | int
    prompt: str


def read_prompt_list(path: str | Path) -> list[ListedPrompt]:
    """The entries of a file, in their order; empty lines count for nothing.

    Raises:
      ValueError: the file cannot be read or is empty, or a line is not as it must be; names file and line.
    """
    from scjax.scene.document import parse_document

    path = Path(path)
    try:
        lines = path.read_bytes().splitlines()
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}): give a file of prompts") from error
    entries: list[ListedPrompt] = []
    lines_of: dict[str, int] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        place = f"{path}, line {number}"
        content = parse_document(line, _Line, place, _CURE)
        name = str(content.id)
        if not _ID.fullmatch(name):
            raise ValueError(f"{place}: id {name[:60]!r} is no name of a folder: use letters, digits, - and _")
        if name.lower() in lines_of:  # some file systems take upper and lower case for the same
            raise ValueError(f"{place}: id {name!r} is that of line {lines_of[name.lower()]}, too: give another one")
        if not content.prompt.strip():
            raise ValueError(f"{place}: prompt is empty: say what the scene should show")
        lines_of[name.lower()] = number
        entries.append(ListedPrompt(name, content.prompt))
    if not entries:
        raise ValueError(f"{path} holds no prompts: {_CURE}")
    return entries


def progress_of_chunks(entries: Sequence[ListedPrompt]) -> Iterator[tuple[int, Sequence[ListedPrompt]]]:
    """(number, entries) of every part of ``CHUNK`` prompts, under a progress bar."""
    from tqdm import tqdm

    with tqdm(total=len(entries), unit="prompt", disable=len(entries) <= CHUNK) as bar:
        for number, start in enumerate(range(0, len(entries), CHUNK)):
            some = entries[start : start + CHUNK]
            yield number, some
            bar.update(len(some))


def understood_conditions(
    entries: Sequence[ListedPrompt], fields: Mapping[str, Any], model: Model, *, quiet: bool
) -> list[Condition]:
    """A condition for every prompt, with what it asks for as attributes, where the model takes prompts as requests.

    Then it says what was understood of prompts without an id, unless ``quiet``, and what will not come true.

    Args:
      fields: of all conditions.
    """
    from scjax.generate.conditions import Condition
    from scjax.generate.readings import prompt_warnings, read_prompts, reads_requests
    from scjax.language.attributes.shown import shown_request

    conditions = read_prompts([Condition(prompt=entry.prompt, **fields) for entry in entries], model)
    if not reads_requests(model):
        return conditions
    for entry, condition in zip(entries, conditions, strict=True):
        if condition.attributes and not entry.id:
            say(f"understood: {shown_request(condition.attributes)}", quiet=quiet)
        for warning in prompt_warnings(condition):
            say(f"scjax: warning: {entry.id}{': ' if entry.id else ''}{warning}")
    return conditions
