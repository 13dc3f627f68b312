"""Captions of records, and captions of the official release.

``captions-<split>.jsonl.gz`` holds one line per record, in record order: its facts and some texts of each style. A file
appears whole or not at all, and names the hash of the records that it belongs to.
"""

from __future__ import annotations

import functools
import gzip
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from scjax.data import records
from scjax.data.build import load_manifest
from scjax.data.workers import WorkerPool
from scjax.language.captioner import STYLES, write_caption
from scjax.language.facts import Facts, extract_facts

FORMAT = 2


class Caption(NamedTuple):
    """Facts of the centered crop of a record, and texts of every style."""

    facts: Facts
    texts: dict[str, list[str]]


def add_captions(
    folder: str | Path,
    *,
    paraphrases: int = 2,
    drop: float = 0.3,
    seed: int = 0,
    workers: int = 0,
    progress: bool = True,
) -> dict[str, int]:
    """Captions every record of a folder; returns the number of records of each split.

    Args:
      folder: made by ``python -m scjax.data build``.
      paraphrases: texts of each style per record.
      drop: probability with which an optional fact is left out.
      seed: of the choice of words; the same seed gives the same texts.
      workers: processes that share the work; 0: this process does it.
      progress: whether to show a progress bar.

    Raises:
      ValueError: the folder holds no records, ``paraphrases`` is less than 1, ``drop`` is no probability, or
        ``workers`` less than 0.
    """
    if paraphrases < 1:
        raise ValueError(f"paraphrases is {paraphrases}: write at least one text of each style")
    if not 0 <= drop <= 1:
        raise ValueError(f"drop is {drop}: give a probability, 0 to write all facts")
    if workers < 0:
        raise ValueError(f"workers is {workers}: give 0 or more processes")
    folder, counts = Path(folder), {}
    manifest = load_manifest(folder)
    for split, entry in manifest["splits"].items():
        if not entry["records"]:
            continue
        path = captions_path(folder, split)
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        caption = functools.partial(_caption_line, folder, split, manifest["hash"], paraphrases, drop, seed)
        rows, label = range(entry["records"]), f"captions of {split}"
        with gzip.open(temporary, "wt", encoding="utf-8") as file, WorkerPool(workers, chunk_size=32) as run:
            file.write(json.dumps({"format": FORMAT, "records": manifest["hash"], "seed": seed, "drop": drop}) + "\n")
            lines = run(caption, rows)
            file.writelines(tqdm(lines, label, total=len(rows), unit="record", disable=not progress))
        temporary.replace(path)
        counts[split] = len(rows)
    return counts


def _caption_line(
    folder: Path, split: str, records_hash: str, paraphrases: int, drop: float, seed: int, row: int
) -> str:
    """The line of one record in the captions file."""
    record = records.decode_record(_open_records(folder, split, records_hash)[row])
    facts = extract_facts(records.sample_scene(record))
    seeds = np.random.SeedSequence([seed, row]).generate_state(len(STYLES) * paraphrases)
    texts = {
        style: [write_caption(facts, int(seeds[k * paraphrases + n]), style, drop=drop) for n in range(paraphrases)]
        for k, style in enumerate(STYLES)
    }
    return json.dumps({"facts": facts.to_json(), "texts": texts}, ensure_ascii=False) + "\n"


@functools.lru_cache(1)
def _open_records(folder: Path, split: str, records_hash: str):
    """The records of a split, opened once per process; the hash distinguishes records that were built again."""
    del records_hash
    return records.open_records(folder, split)


def read_captions(folder: str | Path, split: str) -> Iterator[Caption]:
    """Captions of a split, in record order.

    Raises:
      ValueError: there are none, or they belong to other records or another format.
    """
    path, remedy = captions_path(Path(folder), split), f"run python -m scjax.data caption {folder}"
    if not path.is_file():
        raise ValueError(f"{path} is not there: {remedy}")
    with gzip.open(path, "rt", encoding="utf-8") as file:
        head = json.loads(file.readline())
        if head.get("format") != FORMAT or head.get("records") != load_manifest(folder)["hash"]:
            raise ValueError(f"{path} was written for other records or in another format: {remedy} again")
        for line in file:
            content = json.loads(line)
            yield Caption(Facts.from_json(content["facts"]), content["texts"])


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
