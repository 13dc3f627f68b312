"""Where the scenes of a build come from, and the poses at which they are cut."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from scjax.data.lane_graph import LaneGraph, SegmentIndex, build_graph, index_segments
from scjax.data.readers.scene_json import RawScene, parse_scene, read_bytes
from scjax.data.tiles import Pose, find_poses

_NAMED = (b"dataset", b"location_cluster")
SKIPPED_FOLDERS = ("peer_outputs", "images")  # generated scenes; pictures (any name that starts like this)


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
    """A scene of a source as the plan of a build sees it."""

    file: str  # its name in the source
    sha256: str = ""
    domain: str = ""
    cluster: str = ""
    reason: str = ""  # why it cannot be used; empty if it can


@dataclasses.dataclass(frozen=True)
class Loaded:
    """A scene ready to be cut: the first ``num_standard`` poses are standard ones; labels of each, if there are any.

    With ``keep_parked`` vehicles parked off the lanes are agents like all others (``Context.off_road``).
    """

    raw: RawScene
    graph: LaneGraph
    index: SegmentIndex
    poses: list[Pose]
    num_standard: int
    labels: list[dict[str, Any]] | None = None
    keep_parked: bool = False


@runtime_checkable
class Source(Protocol):
    """Scenes by name. Implementations are small and can be sent to worker processes."""

    def names(self) -> list[str]:
        """All scenes, in order."""
        ...

    def scan(self, name: str) -> Scanned:
        """What can be said of a scene at little cost."""
        ...

    def load(self, item: Scanned, options: BuildOptions, dense: bool) -> Loaded:
        """The scene and its poses, the ``dense`` ones of training or the standard ones alone."""
        ...


@dataclasses.dataclass(frozen=True)
class Recordings:
    """Every ``*.json.gz`` under a folder; folders of pictures and of generated scenes are left out."""

    folder: str

    def names(self) -> list[str]:
        """Files relative to the folder, sorted.

        Raises:
          ValueError: if the folder does not exist or holds none.
        """
        folder = Path(self.folder)
        if not folder.is_dir():
            raise ValueError(f"{folder}: no such folder: give the folder that holds the *.json.gz scenes")
        found = (path.relative_to(folder) for path in folder.rglob("*.json.gz"))
        files = sorted(
            p.as_posix() for p in found if not any(part.startswith(SKIPPED_FOLDERS) for part in p.parts[:-1])
        )
        if not files:
            raise ValueError(f"{folder}: no *.json.gz scenes there: give the folder that holds them")
        return files

    def scan(self, name: str) -> Scanned:
        """Hash, data set and cluster of a file, or why it cannot be used."""
        path = Path(self.folder, name)
        try:
            data = read_bytes(path)
            # The two names without parsing megabytes of JSON; anything unusual goes through the parser.
            found = [re.findall(rb'"%s": ?("(?:[^"\\]|\\.)*")' % key, data) for key in _NAMED]
            if all(len(values) == 1 for values in found):
                domain, cluster = (json.loads(values[0]) for values in found)
            else:
                raw = parse_scene(data, path)
                domain, cluster = raw.domain, raw.cluster
        except ValueError as error:
            return Scanned(name, reason=str(error))
        return Scanned(name, hashlib.sha256(data).hexdigest(), domain, cluster)

    def load(self, item: Scanned, options: BuildOptions, dense: bool) -> Loaded:
        """Reads the file.

        Raises:
          ValueError: naming the file, if it cannot be used or has changed since it was scanned.
        """
        path = Path(self.folder, item.file)
        raw = parse_scene(read_bytes(path), path)
        if raw.sha256 != item.sha256:
            raise ValueError(f"{path}: changed while the build ran: build again")
        graph = build_graph(raw)
        index = index_segments(graph)
        standard = find_poses(raw, index, **dataclasses.asdict(options.poses))
        poses = standard
        if dense:
            poses = find_poses(raw, index, **dataclasses.asdict(options.train_poses), first=standard)
        return Loaded(raw, graph, index, poses, len(standard))
