"""The tasks of a build: looking at one source file, and making one shard. Both run in worker processes."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scjax.data.readers.base import BuildOptions, Scanned, Source
from scjax.data.records import RECORD_FORMAT, encode, make_record, sample_scene, simplified, write_shard
from scjax.data.statistics import SceneStatistics

MANIFEST_FORMAT = 1


@dataclasses.dataclass(frozen=True)
class Shard:
    """A shard to be: its file name without extension, its sources, and all that its content depends on."""

    name: str
    dense: bool  # training poses on top of the standard ones
    files: tuple[Scanned, ...]
    domains: tuple[str, ...]
    options: BuildOptions

    def fingerprint(self) -> str:
        """Equal only if rebuilding would give the same shard (from the same code)."""
        content = [MANIFEST_FORMAT, RECORD_FORMAT, dataclasses.asdict(self)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def scan(task: tuple[Source, str]) -> Scanned:
    """Looks at (source, name of a scene)."""
    source, name = task
    return source.scan(name)


def build_shard(task: tuple[Source, str, Shard, bool]) -> dict[str, Any]:
    """Makes (source, output folder, shard, resume) and reports on it, or finds it made already."""
    source, out, shard, resume = task
    path, progress = Path(out, f"{shard.name}.arrayrecord"), Path(out, "progress", f"{shard.name}.json")
    fingerprint = shard.fingerprint()
    if resume and path.exists() and progress.exists():
        try:
            report = json.loads(progress.read_text())
        except ValueError:
            report = {}
        if report.get("fingerprint") == fingerprint and report.get("bytes") == path.stat().st_size:
            return report
    report: dict[str, Any] = {"name": shard.name, "fingerprint": fingerprint, "skipped": [], "without_poses": []}
    report |= {"rows": [], "labels": [], "scenes": 0, "cleaned": Counter()}
    statistics = SceneStatistics()

    def encoded() -> Iterator[bytes]:
        for item in shard.files:
            try:
                yield from _records_of(source, item, shard, report, statistics)
            except ValueError as error:
                report["skipped"].append({"file": item.file, "reason": str(error)})

    progress.unlink(missing_ok=True)
    write_shard(path, encoded())
    report |= {"statistics": statistics.state, "bytes": path.stat().st_size}
    write_text(progress, json.dumps(report))
    return report


def _records_of(
    source: Source, item: Scanned, shard: Shard, report: dict[str, Any], statistics: SceneStatistics
) -> list[bytes]:
    loaded = source.load(item, shard.options, shard.dense)
    if not loaded.poses:
        report["without_poses"].append(item.file)
        return []
    raw, lanes, domain = loaded.raw, simplified(loaded.graph), shard.domains.index(loaded.raw.domain)
    encoded, rows, cleaned = [], [], Counter()
    for rank, pose in enumerate(loaded.poses):
        record, counts = make_record(raw, lanes, loaded.index, pose, domain)
        if loaded.keep_parked:
            off_road = np.zeros_like(record.context.off_road)
            record = dataclasses.replace(record, context=dataclasses.replace(record.context, off_road=off_road))
        scene = sample_scene(record)
        if not len(scene.lanes):
            continue
        cleaned.update(counts)
        flags = (int(pose.is_recorder), int(rank < loaded.num_standard))
        statistics.add(scene)
        size = len(scene.lanes), len(scene.agents)
        rows.append([raw.scene_id, raw.cluster, record.domain, pose.step, pose.object, *flags, *size])
        encoded.append(encode(record))
        if loaded.labels:
            report["labels"].append(loaded.labels[rank])
    report["rows"] += rows
    report["cleaned"].update(cleaned)
    report["scenes"] += 1
    return encoded


def write_text(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    temporary.write_text(text)
    os.replace(temporary, path)
