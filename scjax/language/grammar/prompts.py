"""Whole prompts, written by hand as people type them, each with the request that its words make.

A file ``prompts/LANGUAGE-STYLE.tsv`` has one prompt a line: the text, a tab, the request as JSON.
"""

from __future__ import annotations

import functools
import json
from pathlib import Path

import numpy as np

from scjax.language.attributes.contradictions import find_contradictions
from scjax.language.attributes.table import check_attributes
from scjax.language.grammar.compose import Composition
from scjax.language.grammar.noise import make_mistakes
from scjax.language.grammar.phrasebook import phrasebook
from scjax.language.grammar.styles import STYLES

FOLDER = Path(__file__).parent / "prompts"
_MISTAKES = 0.15  # likelihood of each kind


@functools.cache
def written_prompts(folder: Path = FOLDER) -> tuple[Composition, ...]:
    """All prompts of a folder, in the order of its files.

    Raises:
      ValueError: a line is no prompt with a request; names file and line.
    """
    prompts = []
    for path in sorted(folder.glob("*.tsv")):
        language, _, style = path.stem.partition("-")
        if style not in STYLES:
            raise ValueError(f"{path}: there is no style {style!r}: name the file LANGUAGE-STYLE.tsv")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            prompts.append(_prompt(line, style, language, f"{path}:{number}"))
    return tuple(prompts)


def _prompt(line: str, style: str, language: str, place: str) -> Composition:
    text, tab, request = line.partition("\t")
    if not (tab and text.strip()):
        raise ValueError(f"{place}: write a prompt, a tab and its request as JSON")
    try:
        normal = check_attributes(json.loads(request))
    except ValueError as error:
        raise ValueError(f"{place}: the request is wrong ({error})") from error
    if pairs := find_contradictions(normal):
        raise ValueError(f"{place}: {' and '.join(pairs[0])} contradict each other: mend the request")
    return Composition(text, normal, style, language)


def retype(prompt: Composition, rng: np.random.Generator) -> Composition:
    """A prompt as another hand would type it, some with mistakes."""
    return prompt._replace(text=make_mistakes(prompt.text, phrasebook(prompt.language), _MISTAKES, rng))
