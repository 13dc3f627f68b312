"""Reader of OpenDRIVE files, versions 1.2 to 1.8 (ASAM): maps without traffic.

Superelevation is read; shapes across the road, heights of lanes, objects, rails and the middle of virtual junctions are
not. Lights for cars give the lanes that they control; signs are counted.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Iterator
from pathlib import Path

from scjax.data.readers.base import LogInfo, files_below
from scjax.data.readers.opendrive.elements import MAX_BYTES, parse_elements
from scjax.data.readers.opendrive.map_lanes import road_map_log
from scjax.data.readers.opendrive.road_map import RoadMap, build_road_map
from scjax.scene import Log, LogMetadata, validate_log
from scjax.scene.files import MEGABYTE, read_limited

OPENDRIVE_PATTERN = "*.xodr"
OPENDRIVE_DOMAIN = "opendrive"


@dataclasses.dataclass(frozen=True)
class OpenDriveReader:
    """Every ``*.xodr`` below a folder; each is a location of its own, named by its path."""

    folder: str

    def __str__(self) -> str:
        return self.folder

    def names(self) -> list[str]:
        """Files relative to the folder, sorted.

        Raises:
          ValueError: if the folder does not exist or holds none.
        """
        return files_below(self.folder, OPENDRIVE_PATTERN)

    def scan(self, name: str) -> LogInfo:
        """Hash and location of a file, or the reason why it cannot be read."""
        try:
            data = _read_bytes(Path(self.folder, name))
        except ValueError as error:
            return LogInfo(name, reason=str(error))
        return LogInfo(name, hashlib.sha256(data).hexdigest(), OPENDRIVE_DOMAIN, _cluster(name))

    def read(self, name: str) -> Log:
        """The map in a file of the folder.

        Raises:
          ValueError: as ``read_opendrive``.
        """
        return read_opendrive(Path(self.folder, name), _cluster(name))


def read_opendrive(path: str | Path, location: str = "") -> Log:
    """The map in an OpenDRIVE file: a log of one step without objects.

    Args:
      location: ``LogMetadata.location_cluster``; the name of the file by default.

    Raises:
      ValueError: naming the file, the element with its line, what is wrong with it and what to do.
    """
    path = Path(path)
    data = _read_bytes(path)
    with _named(path):
        road_map = build_road_map(parse_elements(data))
        metadata = LogMetadata(
            domain=OPENDRIVE_DOMAIN,
            scene_id=location or path.stem,
            location_cluster=location or path.stem,
            variant="opendrive",
            source_file=str(path),
            source_sha256=hashlib.sha256(data).hexdigest(),
            unknown_words=dict(sorted(road_map.unknown_words.items())),
            notes=dict(sorted(road_map.notes.items())),
        )
        return validate_log(road_map_log(road_map, metadata))


def read_road_map(path: str | Path) -> RoadMap:
    """The lanes of an OpenDRIVE file with their widths and file types, which a log does not hold.

    Raises:
      ValueError: as ``read_opendrive``.
    """
    data = _read_bytes(Path(path))
    with _named(path):
        return build_road_map(parse_elements(data))


@contextlib.contextmanager
def _named(path: str | Path) -> Iterator[None]:
    """Within it, errors name the file."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _read_bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise ValueError(f"{path}: it has {size // MEGABYTE} MB, more than {MAX_BYTES // MEGABYTE}: split the map")
        return read_limited(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path}: No such file: give an {OPENDRIVE_PATTERN} file") from error


def _cluster(name: str) -> str:
    return name.removesuffix(".xodr")
