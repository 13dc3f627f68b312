"""Logs -> ArrayRecord shards of training records and a manifest; resumable, one task per shard."""

from __future__ import annotations

import dataclasses
import gzip
import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from scjax.data.build_options import BuildOptions
from scjax.data.build_shards import INDEX_COLUMNS, Shard, build_shard, scan_log
from scjax.data.manifest import MANIFEST_FORMAT, file_entry
from scjax.data.manifest import load_manifest as load_manifest
from scjax.data.ranges import MAX_SEED, check_number, check_workers
from scjax.data.readers import open_folder
from scjax.data.readers.base import LogInfo
from scjax.data.record_checks import RECORD_FORMAT
from scjax.data.record_folder import locked_records
from scjax.data.record_source import ReaderSource, RecordSource
from scjax.data.statistics import SceneStatistics
from scjax.data.workers import WorkerPool
from scjax.scene.files import write_file, write_text

SPLITS = ("train", "val")
_NO_EGO_FOUND = "no vehicle to take as ego; --lane-poses N takes N poses along the lanes of such maps"


def build_records(
    source: str | Path | RecordSource,
    out: str | Path,
    options: BuildOptions | None = None,
    *,
    workers: int = 0,
    limit: int | None = None,
    resume: bool = True,
    strict: bool = False,
    make_shard: Callable[[tuple[RecordSource, str, Shard, bool]], dict[str, Any]] = build_shard,
) -> dict[str, Any]:
    """Builds records from every log of ``source``; returns the manifest, which is also written to ``out``.

    Finished shards whose sources, options and format are unchanged are kept, so a build that was killed continues. The
    split is by location cluster: a stable hash of (data set, cluster), so that adding logs moves none. Sources that
    hold locations back themselves say so (``LogInfo.split``).

    Args:
      source: a folder of recorded scenes (``scjax.data.readers``), or any other source.
      workers: processes; 0 works in this one.
      limit: use only the first files, by name.
      resume: keep finished shards.
      strict: stop at the first file that cannot be used or looks wrong, instead of listing it in the manifest.
      make_shard: the task that builds one shard.

    Raises:
      ValueError: an argument is out of its range, no scene files in ``source``, none usable, ``out`` is a file or in
        use by another process or, if ``strict``, the first bad file.
      OSError: a file cannot be written; names it.
    """
    options = options or BuildOptions()
    check_workers(workers)
    if limit is not None:
        check_number("limit", limit, 1, MAX_SEED, "use at least one file")
    source = ReaderSource(open_folder(source)) if isinstance(source, str | Path) else source
    out = Path(out)
    files = source.names()[:limit]
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is not a folder: choose another output folder")
    with locked_records(out):
        (out / "manifest.json").unlink(missing_ok=True)  # it vouches for a complete set of shards
        manifest = _build(source, out, files, options, workers, resume, strict, make_shard)
        write_text(out / "manifest.json", json.dumps(manifest, indent=1))
    return manifest


def _build(
    source: RecordSource,
    out: Path,
    files: list[str],
    options: BuildOptions,
    workers: int,
    resume: bool,
    strict: bool,
    make_shard: Callable[[tuple[RecordSource, str, Shard, bool]], dict[str, Any]],
) -> dict[str, Any]:
    """Writes everything but the manifest, which it returns."""
    with WorkerPool(workers) as run:
        infos = list(_progress(run(scan_log, [(source, file) for file in files]), len(files), "scan", "file"))
        _stop_if_strict(strict, _skipped(infos))
        usable = [info for info in infos if not info.reason]
        if not usable:
            raise ValueError(_none_usable(source, infos, infos[0].reason if infos else "it is empty"))
        domains = tuple(sorted({info.domain for info in usable}))
        shards = _plan_shards(usable, domains, options)
        _remove_stale_shards(out, shards)
        tasks = [(source, str(out), shard, resume) for shard in shards]
        reports = []
        for report in _progress(run(make_shard, tasks), len(tasks), "build", "shard"):
            _stop_if_strict(strict, report["skipped"])
            _stop_if_strict(strict, [_as_reason(entry) for entry in report.get("warnings", [])])
            reports.append(report)

    if not any(report["rows"] for report in reports):
        reasons = [entry["reason"] for report in reports for entry in report["skipped"]]
        raise ValueError(_none_usable(source, infos, [*reasons, _NO_EGO_FOUND][0]))
    manifest = _make_manifest(infos, shards, reports, domains, options)
    for split in SPLITS:
        split_reports = [report for report in reports if report["name"].startswith(split)]
        _write_index(out, split, split_reports)
        _write_labels(out, split, split_reports)
    return manifest


def split_of(domain: str, cluster: str, percent: float) -> str:
    """The split, "train" or "val", of a location cluster; depends on the arguments only."""
    digest = hashlib.sha256(f"{domain}/{cluster}".encode()).digest()
    return "val" if int.from_bytes(digest[:8], "big") < percent / 100 * 2**64 else "train"


def _split_of(info: LogInfo, options: BuildOptions) -> str:
    return info.split or split_of(info.domain, info.cluster, options.split_percent)


def _plan_shards(usable: list[LogInfo], domains: tuple[str, ...], options: BuildOptions) -> list[Shard]:
    shards = []
    for split in SPLITS:
        files = [info for info in usable if _split_of(info, options) == split]
        chunks = [files[i : i + options.files_per_shard] for i in range(0, len(files), options.files_per_shard)]
        for number, chunk in enumerate(chunks):
            name = f"{split}-{number:05d}-of-{len(chunks):05d}"
            shards.append(Shard(name, split == "train", tuple(chunk), domains, options))
    return shards


def _make_manifest(
    infos: list[LogInfo], shards: list[Shard], reports: list[dict], domains: tuple[str, ...], options: BuildOptions
) -> dict[str, Any]:
    cluster_of = {info.file: f"{info.domain}/{info.cluster}" for info in infos}
    statistics, count_table, cleaned = SceneStatistics(), Counter(), Counter()
    splits: dict[str, dict[str, Any]] = {}
    for split in SPLITS:
        pairs = [pair for pair in zip(shards, reports, strict=True) if pair[0].name.startswith(split)]
        splits[split] = {
            "clusters": sorted({cluster_of[info.file] for shard, _ in pairs for info in shard.files}),
            "scenes": sum(report["scenes"] for _, report in pairs),
            "records": sum(len(report["rows"]) for _, report in pairs),
            "shards": [f"{shard.name}.arrayrecord" for shard, _ in pairs],
        }
        for _, report in pairs:
            cleaned.update(report["cleaned"])
            if split == "train":
                statistics.merge(report["statistics"])
                rows = (dict(zip(INDEX_COLUMNS, row, strict=True)) for row in report["rows"])
                count_table.update(
                    (row["domain"], row["num_lanes"], row["num_agents"]) for row in rows if row["is_standard"]
                )
    manifest = {
        "format": MANIFEST_FORMAT,
        "record_format": RECORD_FORMAT,
        "options": dataclasses.asdict(options),
        "domains": list(domains),
        "splits": splits,
        "cleaned": dict(cleaned),
        "skipped": _skipped(infos) + [entry for report in reports for entry in report["skipped"]],
        "warnings": [entry for report in reports for entry in report.get("warnings", [])],
        "notes": [entry for report in reports for entry in report.get("notes", [])],
        "without_poses": [file for report in reports for file in report["without_poses"]],
        "statistics": statistics.summary(),
        "counts": [[*key, count] for key, count in sorted(count_table.items())],
        "sources": {info.file: info.sha256 for info in infos if not info.reason},
        "files": {f"{entry['name']}.arrayrecord": file_entry(entry["bytes"], entry["sha256"]) for entry in reports},
    }
    content = [[shard.fingerprint() for shard in shards], manifest["skipped"]]
    return {"hash": hashlib.sha256(json.dumps(content).encode()).hexdigest(), **manifest}


def _write_index(out: Path, split: str, reports: list[dict]) -> None:
    """``<split>-index.npz``: one row per record, for samplers that weigh records by where they come from."""
    columns = list(zip(*(row for report in reports for row in report["rows"]), strict=True))
    path = out / f"{split}-index.npz"
    if not columns:
        path.unlink(missing_ok=True)
        return
    arrays: dict[str, Any] = {name: np.array(c) for name, c in zip(INDEX_COLUMNS, columns, strict=True)}
    write_file(path, lambda file: np.savez_compressed(file, **arrays))


def _write_labels(out: Path, split: str, reports: list[dict]) -> None:
    """``<split>-labels.jsonl.gz``: one line per record, for sources that know what their scenes show."""
    path = out / f"{split}-labels.jsonl.gz"
    lines = [json.dumps(label, separators=(",", ":")) for report in reports for label in report.get("labels", [])]
    if not lines:
        path.unlink(missing_ok=True)
        return
    write_file(path, lambda file: file.write(gzip.compress("\n".join(lines).encode() + b"\n", mtime=0)))


def _skipped(infos: list[LogInfo]) -> list[dict[str, str]]:
    return [{"file": info.file, "reason": info.reason} for info in infos if info.reason]


def _as_reason(entry: dict[str, Any]) -> dict[str, str]:
    found = "; ".join(f"{text} ({count})" if count > 1 else text for text, count in entry["found"].items())
    return {"file": entry["file"], "reason": f"{entry['file']}: {found}"}


def _none_usable(source: RecordSource, infos: list[LogInfo], reason: str) -> str:
    return f"{source}: none of {len(infos)} files can be used; the first: {reason}"


def _remove_stale_shards(out: Path, shards: list[Shard]) -> None:
    """Removes shards of an earlier plan, known by their progress files: they would mix with the new ones."""
    planned = {shard.name for shard in shards}
    for progress in (out / "progress").glob("*.json"):
        if progress.stem not in planned:
            (out / f"{progress.stem}.arrayrecord").unlink(missing_ok=True)
            progress.unlink()
    for split in SPLITS:
        for path in out.glob(f"{split}-*.arrayrecord"):
            if path.stem not in planned:
                raise ValueError(f"{path} was not written by this build: remove it, or choose another output folder")


def _stop_if_strict(strict: bool, skipped: list[dict[str, str]]) -> None:
    if strict and skipped:
        raise ValueError(f"{skipped[0]['reason']} (--strict stops at the first bad file)")


def _progress(results: Iterator[Any], total: int, label: str, unit: str) -> Iterator[Any]:
    return iter(tqdm(results, total=total, desc=label, unit=unit, disable=None))
