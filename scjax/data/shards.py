"""The tasks of a build: looking at one source file, and making one shard. Both run in worker processes."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.records import RECORD_FORMAT, encode, make_record, sample_scene, simplified, write_shard
from scjax.data.scene_json import parse_scene, read_bytes
from scjax.data.statistics import SceneStatistics
from scjax.data.tiles import find_poses

MANIFEST_FORMAT = 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class PoseOptions:
    """Arguments of ``tiles.find_poses``; metres and steps."""

    spacing: float = 16.0
    max_poses: int = 8
    recorder_stride: int = 10
    other_stride: int = 30


@dataclasses.dataclass(frozen=True, kw_only=True)
class BuildOptions:
    """What goes into the records.

    Attributes:
      split_percent: share of location clusters held back for validation.
      poses: the standard poses, those of the evaluation set; validation records are these alone.
      train_poses: denser poses that training records have on top.
      files_per_shard: source files a shard is made from.
    """

    split_percent: float = 10.0
    poses: PoseOptions = PoseOptions()
    train_poses: PoseOptions = PoseOptions(spacing=4.0, max_poses=40, recorder_stride=5)
    files_per_shard: int = 16

    def __post_init__(self):
        if not 0 <= self.split_percent < 100:
            raise ValueError(f"split_percent is {self.split_percent}: it must be at least 0 and below 100")
        if self.files_per_shard < 1:
            raise ValueError(f"files_per_shard is {self.files_per_shard}: it must be at least 1")
        for name, poses in (("poses", self.poses), ("train_poses", self.train_poses)):
            for field, value in dataclasses.asdict(poses).items():
                if value <= 0:
                    raise ValueError(f"{name}.{field} is {value}: it must be positive")


@dataclasses.dataclass(frozen=True)
class Scanned:
    """A source file as the plan sees it."""

    file: str  # relative to the source folder
    sha256: str = ""
    domain: str = ""
    cluster: str = ""
    reason: str = ""  # why the file cannot be used; empty if it can


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


def scan(task: tuple[str, str]) -> Scanned:
    """Looks at (source folder, file): its hash, data set and cluster, or why it cannot be used."""
    source, file = task
    path = Path(source, file)
    try:
        data = read_bytes(path)
        # The two names without parsing megabytes of JSON; anything unusual goes through the parser.
        names = [re.findall(rb'"%s": ?("(?:[^"\\]|\\.)*")' % key, data) for key in (b"dataset", b"location_cluster")]
        if all(len(found) == 1 for found in names):
            domain, cluster = (json.loads(found[0]) for found in names)
        else:
            raw = parse_scene(data, path)
            domain, cluster = raw.domain, raw.cluster
    except ValueError as error:
        return Scanned(file, reason=str(error))
    return Scanned(file, hashlib.sha256(data).hexdigest(), domain, cluster)


def build_shard(task: tuple[str, str, Shard, bool]) -> dict[str, Any]:
    """Makes (source folder, output folder, shard, resume) and reports on it, or finds it made already."""
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
    report |= {"rows": [], "scenes": 0, "cleaned": Counter()}
    statistics = SceneStatistics()

    def encoded() -> Iterator[bytes]:
        for item in shard.files:
            try:
                yield from _records_of(Path(source, item.file), item, shard, report, statistics)
            except ValueError as error:
                report["skipped"].append({"file": item.file, "reason": str(error)})

    progress.unlink(missing_ok=True)
    write_shard(path, encoded())
    report |= {"statistics": statistics.state, "bytes": path.stat().st_size}
    write_text(progress, json.dumps(report))
    return report


def _records_of(
    path: Path, item: Scanned, shard: Shard, report: dict[str, Any], statistics: SceneStatistics
) -> list[bytes]:
    raw = parse_scene(read_bytes(path), path)
    if raw.sha256 != item.sha256:
        raise ValueError(f"{path}: changed while the build ran: build again")
    graph = build_graph(raw)
    index = index_segments(graph)
    standard = find_poses(raw, index, **dataclasses.asdict(shard.options.poses))
    poses = standard
    if shard.dense:
        poses = find_poses(raw, index, **dataclasses.asdict(shard.options.train_poses), first=standard)
    if not poses:
        report["without_poses"].append(item.file)
        return []
    lanes, domain = simplified(graph), shard.domains.index(raw.domain)
    encoded, rows, cleaned = [], [], Counter()
    for rank, pose in enumerate(poses):
        record, counts = make_record(raw, lanes, index, pose, domain)
        scene = sample_scene(record)
        if not len(scene.lanes):
            continue
        statistics.add(scene)
        cleaned.update(counts)
        flags = (int(pose.is_recorder), int(rank < len(standard)))
        rows.append([raw.scene_id, raw.cluster, domain, pose.step, pose.object, *flags, len(scene.lanes),
                     len(scene.agents)])  # fmt: skip
        encoded.append(encode(record))
    report["rows"] += rows
    report["cleaned"].update(cleaned)
    report["scenes"] += 1
    return encoded


def write_text(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    temporary.write_text(text)
    os.replace(temporary, path)
