"""Folder of recorded scenes -> ArrayRecord shards of training records and a manifest; resumable, one task a shard."""

from __future__ import annotations

import dataclasses
import gzip
import hashlib
import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from scjax.data.readers.base import BuildOptions, Recordings, Scanned, Source
from scjax.data.records import RECORD_FORMAT
from scjax.data.shards import MANIFEST_FORMAT, Shard, build_shard, scan, write_text
from scjax.data.statistics import SceneStatistics
from scjax.data.workers import Mapper

SPLITS = ("train", "val")
_NONE = "{}: none of {} files can be used; the first: {}"


def build(
    source: str | Path | Source,
    out: str | Path,
    options: BuildOptions | None = None,
    *,
    workers: int = 0,
    limit: int | None = None,
    resume: bool = True,
    strict: bool = False,
) -> dict[str, Any]:
    """Builds records from every scene of ``source``; returns the manifest, also written to ``out``.

    Finished shards whose sources, options and format are unchanged are kept, so a build that was killed continues. The
    split is by location cluster: a stable hash of (data set, cluster), so that adding scenes moves none.

    Args:
      source: a folder of ``*.json.gz`` files, or any other source.
      workers: processes; 0 works in this one.
      limit: use only the first files, by name.
      strict: stop at the first file that cannot be used instead of listing it in the manifest.

    Raises:
      ValueError: no scene files in ``source``, none usable, ``out`` is a file or, if ``strict``, the first bad file.
    """
    options = options or BuildOptions()
    source, out = Recordings(str(source)) if isinstance(source, str | Path) else source, Path(out)
    files = source.names()[:limit]
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is not a folder: choose another output folder")
    (out / "progress").mkdir(parents=True, exist_ok=True)
    manifest_path = out / "manifest.json"
    manifest_path.unlink(missing_ok=True)  # it vouches for a complete set of shards
    for left in out.glob(".*.part"):
        left.unlink()

    with Mapper(workers) as run:
        scanned = list(_progress(run(scan, [(source, file) for file in files]), len(files), "scan", "file"))
        _stop_if_strict(strict, [{"file": item.file, "reason": item.reason} for item in scanned if item.reason])
        usable = [item for item in scanned if not item.reason]
        if not usable:
            first = next((item for item in scanned if item.reason), None)
            raise ValueError(_NONE.format(source, len(files), first and first.reason))
        domains = tuple(sorted({item.domain for item in usable}))
        shards = _plan(usable, domains, options)
        _remove_stale(out, shards)
        tasks = [(source, str(out), shard, resume) for shard in shards]
        reports = []
        for report in _progress(run(build_shard, tasks), len(tasks), "build", "shard"):
            _stop_if_strict(strict, report["skipped"])
            reports.append(report)

    if not any(report["rows"] for report in reports):
        reasons = [entry["reason"] for report in reports for entry in report["skipped"]]
        raise ValueError(_NONE.format(source, len(files), [*reasons, "no vehicle to take as ego"][0]))
    manifest = _manifest(scanned, shards, reports, domains, options)
    for split in SPLITS:
        _write_index(out, split, [r for r in reports if r["name"].startswith(split)])
        _write_labels(out, split, [r for r in reports if r["name"].startswith(split)])
    write_text(manifest_path, json.dumps(manifest, indent=1))
    return manifest


def load_manifest(folder: str | Path) -> dict[str, Any]:
    """manifest.json of a record folder.

    Keys: ``format``, ``record_format``, ``hash`` (of sources and options), ``options``, ``domains`` (names; records
    hold indices), ``splits`` (per split: clusters, scenes, records, shards), ``counts`` (rows of domain, N_lanes,
    N_agents, number of centred training tiles at standard poses), ``statistics`` (per column, training records),
    ``cleaned`` (filled sizes, clipped speeds), ``skipped`` (files and why), ``without_poses``, ``sources``
    (file -> sha256).

    Raises:
      ValueError: if it is missing (the build is not finished), damaged, or of another format.
    """
    path = Path(folder) / "manifest.json"
    try:
        manifest = json.loads(path.read_text())
    except FileNotFoundError as error:
        raise ValueError(f"{path}: not there: run `python -m scjax.data build SOURCE {folder}` to its end") from error
    except ValueError as error:
        raise ValueError(f"{path}: not valid JSON ({error}): build the records again") from error
    if manifest.get("format") != MANIFEST_FORMAT or manifest.get("record_format") != RECORD_FORMAT:
        raise ValueError(
            f"{path}: format {manifest.get('format')}/{manifest.get('record_format')}, this code reads "
            f"{MANIFEST_FORMAT}/{RECORD_FORMAT}: build the records again"
        )
    return manifest


def split_of(domain: str, cluster: str, percent: float) -> str:
    """ "train" or "val" for a location cluster, for ever the same."""
    digest = hashlib.sha256(f"{domain}/{cluster}".encode()).digest()
    return "val" if int.from_bytes(digest[:8], "big") < percent / 100 * 2**64 else "train"


_INDEX_COLUMNS = ("scene", "cluster", "domain", "step", "object", "is_recorder", "is_standard", "num_lanes",
                  "num_agents")  # fmt: skip


def _plan(usable: list[Scanned], domains: tuple[str, ...], options: BuildOptions) -> list[Shard]:
    shards = []
    for split in SPLITS:
        files = [item for item in usable if split_of(item.domain, item.cluster, options.split_percent) == split]
        chunks = [files[i : i + options.files_per_shard] for i in range(0, len(files), options.files_per_shard)]
        for number, chunk in enumerate(chunks):
            name = f"{split}-{number:05d}-of-{len(chunks):05d}"
            shards.append(Shard(name, split == "train", tuple(chunk), domains, options))
    return shards


def _manifest(
    scanned: list[Scanned], shards: list[Shard], reports: list[dict], domains: tuple[str, ...], options: BuildOptions
) -> dict[str, Any]:
    cluster_of = {item.file: f"{item.domain}/{item.cluster}" for item in scanned}
    statistics, joint, cleaned = SceneStatistics(), Counter(), Counter()
    splits: dict[str, dict[str, Any]] = {}
    for split in SPLITS:
        own = [(s, r) for s, r in zip(shards, reports, strict=True) if s.name.startswith(split)]
        splits[split] = {
            "clusters": sorted({cluster_of[item.file] for shard, _ in own for item in shard.files}),
            "scenes": sum(report["scenes"] for _, report in own),
            "records": sum(len(report["rows"]) for _, report in own),
            "shards": [f"{shard.name}.arrayrecord" for shard, _ in own],
        }
        for _, report in own:
            cleaned.update(report["cleaned"])
            if split == "train":
                statistics.merge(report["statistics"])
                joint.update((row[2], row[7], row[8]) for row in report["rows"] if row[6])
    skipped = [{"file": item.file, "reason": item.reason} for item in scanned if item.reason]
    manifest = {
        "format": MANIFEST_FORMAT,
        "record_format": RECORD_FORMAT,
        "options": dataclasses.asdict(options),
        "domains": list(domains),
        "splits": splits,
        "cleaned": dict(cleaned),
        "skipped": skipped + [entry for report in reports for entry in report["skipped"]],
        "without_poses": [file for report in reports for file in report["without_poses"]],
        "statistics": statistics.summary(),
        "counts": [[*key, count] for key, count in sorted(joint.items())],
        "sources": {item.file: item.sha256 for item in scanned if not item.reason},
    }
    content = [[shard.fingerprint() for shard in shards], manifest["skipped"]]
    return {"hash": hashlib.sha256(json.dumps(content).encode()).hexdigest(), **manifest}


def _write_index(out: Path, split: str, reports: list[dict]) -> None:
    """``<split>-index.npz``: one row a record, for samplers that weigh records by where they come from."""
    columns = list(zip(*(row for report in reports for row in report["rows"]), strict=True))
    path = out / f"{split}-index.npz"
    if not columns:
        path.unlink(missing_ok=True)
        return
    temporary = out / f".{split}-index.{os.getpid()}.part"
    with temporary.open("wb") as file:
        arrays: dict[str, Any] = {name: np.array(c) for name, c in zip(_INDEX_COLUMNS, columns, strict=True)}
        np.savez_compressed(file, **arrays)
    os.replace(temporary, path)


def _write_labels(out: Path, split: str, reports: list[dict]) -> None:
    """``<split>-labels.jsonl.gz``: one line a record, for sources that know what their scenes show."""
    path = out / f"{split}-labels.jsonl.gz"
    lines = [json.dumps(label, separators=(",", ":")) for report in reports for label in report.get("labels", [])]
    if not lines:
        path.unlink(missing_ok=True)
        return
    temporary = out / f".{split}-labels.{os.getpid()}.part"
    temporary.write_bytes(gzip.compress("\n".join(lines).encode() + b"\n", mtime=0))
    os.replace(temporary, path)


def _remove_stale(out: Path, shards: list[Shard]) -> None:
    """Shards of an earlier plan, known by their progress files, would mix with the new ones."""
    planned = {shard.name for shard in shards}
    for progress in (out / "progress").glob("*.json"):
        if progress.stem not in planned:
            (out / f"{progress.stem}.arrayrecord").unlink(missing_ok=True)
            progress.unlink()


def _stop_if_strict(strict: bool, skipped: list[dict[str, str]]) -> None:
    if strict and skipped:
        raise ValueError(f"{skipped[0]['reason']} (--strict stops at the first bad file)")


def _progress(results: Iterator[Any], total: int, what: str, unit: str) -> Iterator[Any]:
    return iter(tqdm(results, total=total, desc=what, unit=unit, disable=None))
