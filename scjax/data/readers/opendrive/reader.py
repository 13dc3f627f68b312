"""Reader of OpenDRIVE files, versions 1.2 to 1.8 (ASAM): maps without traffic.

Superelevation is read; shapes across the road, heights of lanes, objects, rails and the middle of virtual junctions are
not. Lights for cars give the lanes that they control; signs are counted.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from scjax.data.readers.base import FileFormat, naming_file, read_file_bytes
from scjax.data.readers.opendrive.map_lanes import road_map_log
from scjax.data.readers.opendrive.road_map import RoadMap, build_road_map
from scjax.data.readers.xml_elements import has_root, parse_elements
from scjax.scene import Log, LogMetadata, validate_log

OPENDRIVE_DOMAIN = "opendrive"


def read_opendrive(path: str | Path, location: str = "") -> Log:
    """The map in an OpenDRIVE file: a log of one step without objects.

    Args:
      location: ``LogMetadata.location_cluster``; the name of the file by default.

    Raises:
      ValueError: naming the file, the element with its line, what is wrong with it and what to do.
    """
    path = Path(path)
    data = read_file_bytes(path)
    with naming_file(path):
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
    data = read_file_bytes(Path(path))
    with naming_file(path):
        return build_road_map(parse_elements(data))


def _is_opendrive(head: bytes) -> bool:
    return has_root(head, b"OpenDRIVE")


OPENDRIVE = FileFormat("OpenDRIVE", "*.xodr", OPENDRIVE_DOMAIN, _is_opendrive, read_opendrive)
