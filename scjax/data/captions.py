"""Captions of records, and captions of the official release.

``captions-<split>.jsonl.gz`` holds one line per record, in record order: texts in styles and languages, each with the
request that its words make. A file appears whole or not at all, and names the hash of the records that it belongs to.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from scjax.data.manifest import load_manifest
from scjax.data.packed_lines import read_lines, write_lines
from scjax.data.ranges import check_number, check_seed, check_workers
from scjax.data.records import SceneRecord, sample_scene
from scjax.language.attributes.table import check_attributes, measure_attributes
from scjax.language.grammar.compose import Composition, compose
from scjax.scene.document import parse_document

FORMAT = 4
_MAX_TEXTS = 1000


class Caption(NamedTuple):
    """What people could have typed for the centered crop of a record."""

    compositions: list[Composition]

    @property
    def texts(self) -> list[str]:
        """The texts alone."""
        return [composition.text for composition in self.compositions]


def add_captions(
    folder: str | Path,
    *,
    texts: int = 6,
    seed: int = 0,
    workers: int = 0,
    progress: bool = True,
) -> dict[str, int]:
    """Captions every record of a folder; returns the number of records of each split.

    Args:
      folder: made by ``python -m scjax.data build``.
      texts: number of texts per record, in styles and languages at random.
      seed: of the choice of words; the same seed gives the same texts.
      workers: processes that share the work; 0: this process does it.
      progress: whether to show a progress bar.

    Raises:
      ValueError: the folder holds no records, is in use by another process, or an argument is out of its range.
      OSError: a file cannot be written; names it.
    """
    check_number("texts", texts, 1, _MAX_TEXTS, f"write at least one text, {_MAX_TEXTS} at most")
    check_seed(seed)
    check_workers(workers)

    def head_of(manifest: dict[str, Any]) -> bytes:
        return json.dumps({"format": FORMAT, "records": manifest["hash"], "seed": seed}).encode()

    caption = functools.partial(_caption_line, texts, seed)
    return write_lines(
        Path(folder), captions_path, head_of, caption, label="captions", workers=workers, progress=progress
    )


def _caption_line(texts: int, seed: int, record: SceneRecord, row: int) -> bytes:
    """The line of one record in the captions file."""
    measured, rng = measure_attributes(sample_scene(record)), np.random.default_rng([seed, row])
    compositions = [compose(measured, rng) for _ in range(texts)]
    captions = [
        {name: getattr(composition, name) for name in ("text", "request", "style", "language")}
        for composition in compositions
    ]
    return json.dumps({"captions": captions}, ensure_ascii=False).encode()


class _Head(Struct):
    """The first line of a file of captions."""

    format: Any = None
    records: Any = None


class _Text(Struct):
    """A text of a record."""

    text: str
    request: dict[str, Any]
    style: str
    language: str


class _Line(Struct):
    """The line of a record."""

    captions: Annotated[list[_Text], Meta(min_length=1)]


def read_captions(folder: str | Path, split: str) -> Iterator[Caption]:
    """Captions of a split, in record order.

    Raises:
      ValueError: there are none, they belong to other records or another format, or the file is damaged; then with the
        number of the line.
    """
    path, remedy = captions_path(Path(folder), split), f"run python -m scjax.data caption {folder}"
    if not path.is_file():
        raise ValueError(f"{path} is not there: {remedy}")
    manifest = load_manifest(folder)
    number = 0
    for number, line in enumerate(read_lines(path, remedy)):
        name, cure = f"{path}, line {number + 1}", f"{remedy} again"
        if not number:
            head = parse_document(line, _Head, name, cure)
            if head.format != FORMAT or head.records != manifest["hash"]:
                raise ValueError(f"{path} was written for other records or in another format: {cure}")
            continue
        content = parse_document(line, _Line, name, cure)
        try:
            compositions = [
                Composition(item.text, check_attributes(item.request), item.style, item.language)
                for item in content.captions
            ]
        except ValueError as error:
            raise ValueError(f"{name}: {error}: {cure}") from error
        yield Caption(compositions)
    expected = manifest["splits"].get(split, {"records": 0})["records"]
    if number != expected:
        raise ValueError(f"{path} holds captions of {number} records, but there are {expected}: {remedy} again")


def read_official(folder: str | Path, split: str, name: str) -> str | None:
    """The caption of a frame in the folder layout of the official release, or None where its file is absent.

    ``<folder>/<split>/<name>_0_captions.json``, key "BEV"; crops of the other types share it. The release
    reads "A realistic driving scene." instead of None, which would count as following a prompt: leave such scenes out
    of control metrics.

    Raises:
      ValueError: the file is no such JSON.
    """
    path = Path(folder) / split / f"{name}_0_captions.json"
    if not path.is_file():
        return None
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        caption = content["BEV"]
    except (json.JSONDecodeError, UnicodeDecodeError, KeyError, TypeError) as error:
        raise ValueError(f'{path}: no JSON object with a key "BEV" ({error}): leave this file out') from error
    if not isinstance(caption, str):
        raise ValueError(f'{path}: "BEV" holds a {type(caption).__name__}, not a text: leave this file out')
    return caption


def captions_path(folder: Path, split: str) -> Path:
    """The file of a split's captions."""
    return folder / f"captions-{split}.jsonl.gz"
