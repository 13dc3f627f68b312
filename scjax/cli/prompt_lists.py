"""Lists of prompts in a file: one JSON object a line, with "id" and "prompt"."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import msgspec

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
