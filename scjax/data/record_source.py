"""The sources that records are cut from: posed logs by name."""

from __future__ import annotations

import dataclasses
from typing import Any, Protocol, runtime_checkable

from scjax.data.build_options import BuildOptions
from scjax.data.join_options import JoinOptions
from scjax.data.lane_graph import LaneGraph, SegmentIndex, build_graph, index_segments
from scjax.data.lane_poses import lane_poses
from scjax.data.plausibility import log_warnings
from scjax.data.readers.base import LogInfo, LogReader
from scjax.data.tiles import Pose, find_poses
from scjax.scene import Log


@dataclasses.dataclass(frozen=True)
class PosedLog:
    """A log with its lane graph and the poses at which it is cut.

    Attributes:
      graph: lanes of the log; ``index`` is its search structure.
      num_standard: the first so many poses are standard ones (``BuildOptions.poses``).
      labels: what the source knows of each pose, JSON-serializable; None if it knows nothing.
      keep_parked: vehicles parked off the lanes are agents like all others (``LocalMap.off_road``).
      warnings: what looks wrong in the log -> how often; a strict build refuses it.
      notes: what its user may want to know -> how often.
    """

    log: Log
    graph: LaneGraph
    index: SegmentIndex
    poses: list[Pose]
    num_standard: int
    labels: list[dict[str, Any]] | None = None
    keep_parked: bool = False
    warnings: dict[str, int] = dataclasses.field(default_factory=dict)
    notes: dict[str, int] = dataclasses.field(default_factory=dict)


@runtime_checkable
class RecordSource(Protocol):
    """Posed logs by name. Implementations are small, and can be sent to worker processes."""

    def names(self) -> list[str]:
        """Names of all logs, in order."""
        ...

    def scan(self, name: str) -> LogInfo:
        """Content hash and location of a log, or why it cannot be used."""
        ...

    def load(self, item: LogInfo, options: BuildOptions, dense: bool) -> PosedLog:
        """The log and its poses; with ``dense`` those of training, else the standard ones alone."""
        ...


@dataclasses.dataclass(frozen=True)
class ReaderSource:
    """The logs of a reader, at the poses that ``find_poses`` finds."""

    reader: LogReader

    def __str__(self) -> str:
        return str(self.reader)

    def names(self) -> list[str]:
        """As the reader's."""
        return self.reader.names()

    def scan(self, name: str) -> LogInfo:
        """As the reader's."""
        return self.reader.scan(name)

    def load(self, item: LogInfo, options: BuildOptions, dense: bool) -> PosedLog:
        """Reads a log and finds its poses.

        Raises:
          ValueError: naming the file, if it cannot be used or has changed since it was scanned.
        """
        log = self.reader.read(item.file)
        if log.metadata.source_sha256 != item.sha256:
            raise ValueError(f"{log.metadata.source_file}: changed while the build ran: build again")
        graph = build_graph(log, JoinOptions(options.join_distance))
        index = index_segments(graph)
        warnings = {f"unknown {word}": count for word, count in log.metadata.unknown_words.items()}
        warnings |= graph.warnings | dict.fromkeys(log_warnings(log, index), 1)
        standard = find_poses(log, index, **dataclasses.asdict(options.poses))
        poses = standard
        if dense:
            poses = find_poses(log, index, **dataclasses.asdict(options.train_poses), first=standard)
        if not poses and options.lane_poses:
            log, graph, poses = lane_poses(log, graph, index, options.lane_poses)
            standard = poses
        notes = graph.notes | log.metadata.notes
        return PosedLog(log, graph, index, poses, len(standard), warnings=warnings, notes=notes)
