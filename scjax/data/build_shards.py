"""The tasks of a build, which run in worker processes: scanning one log, and building one shard."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from msgspec import Struct

from scjax.data.build_options import BuildOptions
from scjax.data.local_map import simplify_graph
from scjax.data.manifest import MANIFEST_FORMAT
from scjax.data.readers.base import LogInfo
from scjax.data.record_checks import RECORD_FORMAT
from scjax.data.record_source import RecordSource
from scjax.data.records import encode_record, make_record, sample_scene, write_shard
from scjax.data.shards import stamp_file
from scjax.data.statistics import SceneStatistics
from scjax.scene.document import parse_document
from scjax.scene.files import write_text

INDEX_COLUMNS = (  # of a report's "rows", one per record
    "scene",
    "cluster",
    "domain",
    "step",
    "object",
    "is_recorder",
    "is_standard",
    "num_lanes",
    "num_agents",
)


@dataclasses.dataclass(frozen=True)
class Shard:
    """The plan of a shard: all that its content depends on.

    Attributes:
      name: file name without extension.
      dense: whether records at training poses are added to those at standard ones.
      files: logs of the shard.
      domains: names of the data sets; records hold indices into it.
    """

    name: str
    dense: bool
    files: tuple[LogInfo, ...]
    domains: tuple[str, ...]
    options: BuildOptions

    def fingerprint(self) -> str:
        """Equal only if rebuilding would give the same shard (from the same code)."""
        content = [MANIFEST_FORMAT, RECORD_FORMAT, dataclasses.asdict(self)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def scan_log(task: tuple[RecordSource, str]) -> LogInfo:
    """Scans (source, name of a log)."""
    source, name = task
    return source.scan(name)


def build_shard(task: tuple[RecordSource, str, Shard, bool]) -> dict[str, Any]:
    """Builds a shard, or keeps a finished one; returns the report on it, which is stored under ``progress``.

    Args:
      task: (source, output folder, shard, whether to keep a shard that is finished already).
    """
    source, out, shard, resume = task
    path, progress = Path(out, f"{shard.name}.arrayrecord"), Path(out, "progress", f"{shard.name}.json")
    fingerprint = shard.fingerprint()
    finished = _finished_report(path, progress, fingerprint) if resume else None
    if finished is not None:
        return finished
    report: dict[str, Any] = {"name": shard.name, "fingerprint": fingerprint, "skipped": [], "without_poses": []}
    report |= {"rows": [], "labels": [], "scenes": 0, "cleaned": Counter(), "warnings": [], "notes": []}
    statistics = SceneStatistics()

    def encoded_records() -> Iterator[bytes]:
        for item in shard.files:
            try:
                yield from _encode_log(source, item, shard, report, statistics)
            except ValueError as error:
                report["skipped"].append({"file": item.file, "reason": str(error)})

    write_text(progress, json.dumps({"name": shard.name}))  # an unfinished shard is known by this
    write_shard(path, encoded_records())
    report |= {"statistics": statistics.state, **stamp_file(path)._asdict()}
    write_text(progress, json.dumps(report))
    return report


class _Report(Struct):
    """The fields of a report that are read again; see ``build_shard``."""

    name: str
    fingerprint: str
    bytes: int
    sha256: str
    skipped: list[dict[Literal["file", "reason"], str]]
    without_poses: list[str]
    rows: list[tuple[str, str, int, int, int, int, int, int, int]]
    scenes: int
    cleaned: dict[str, int]
    statistics: dict[Literal["agents", "lanes"], dict[str, Any]]


def _finished_report(path: Path, progress: Path, fingerprint: str) -> dict[str, Any] | None:
    """The stored report on the shard at ``path``, if it is complete and rebuilding it would change nothing."""
    try:
        text = progress.read_bytes()
        report = parse_document(text, _Report, progress, "it is written again")
        is_current = report.fingerprint == fingerprint and (report.bytes, report.sha256) == stamp_file(path)
    except (OSError, ValueError):
        return None
    return json.loads(text) if is_current else None


def _encode_log(
    source: RecordSource, item: LogInfo, shard: Shard, report: dict[str, Any], statistics: SceneStatistics
) -> list[bytes]:
    """Encoded records of one log; adds its index rows, labels and counts to ``report``."""
    posed = source.load(item, shard.options, shard.dense)
    for name, found in (("warnings", posed.warnings), ("notes", posed.notes)):
        if found:
            report[name].append({"file": item.file, "found": found})
    if not posed.poses:
        report["without_poses"].append(item.file)
        return []
    metadata, lanes = posed.log.metadata, simplify_graph(posed.graph)
    domain = shard.domains.index(metadata.domain)
    encoded, rows, cleaned = [], [], Counter()
    for rank, pose in enumerate(posed.poses):
        record, counts = make_record(posed.log, lanes, posed.index, pose, domain)
        if posed.keep_parked:
            off_road = np.zeros_like(record.local_map.off_road)
            record = dataclasses.replace(record, local_map=dataclasses.replace(record.local_map, off_road=off_road))
        scene = sample_scene(record)
        if not len(scene.lanes):
            continue
        cleaned.update(counts)
        statistics.add(scene)
        is_standard = rank < posed.num_standard
        rows.append(
            [
                metadata.scene_id,
                metadata.location_cluster,
                record.domain,
                pose.step,
                pose.object_index,
                int(pose.is_recorder),
                int(is_standard),
                len(scene.lanes),
                len(scene.agents),
            ]
        )
        encoded.append(encode_record(record))
        if posed.labels:
            report["labels"].append(posed.labels[rank])
    report["rows"] += rows
    report["cleaned"].update(cleaned)
    report["scenes"] += 1
    return encoded
