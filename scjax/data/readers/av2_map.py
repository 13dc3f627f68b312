"""Reader of vector maps of Argoverse 2: ``log_map_archive_*.json``. They hold no traffic and no lights."""

from __future__ import annotations

import hashlib
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from scjax.data.readers.base import FileFormat, naming_file, read_file_bytes
from scjax.data.readers.bounds import middle_line
from scjax.data.readers.vocabulary import LANE_WORDS, look_up
from scjax.scene import LaneNeighbor, Log, LogMetadata, Map, MapLane, map_to_log, validate_log
from scjax.scene.document import parse_document

AV2_DOMAIN = "av2"
_CURE = "give a log_map_archive_*.json of Argoverse 2, or download it again"
_PREFIX = "log_map_archive_"


class MapPoint(Struct):
    """A point [m]."""

    x: float
    y: float
    z: float = float("nan")


Boundary = Annotated[list[MapPoint], Meta(min_length=1, max_length=1_000_000)]


class LaneSegment(Struct):
    """One lane segment by its two boundaries, and the segments around it."""

    id: int | str
    left_lane_boundary: Boundary
    right_lane_boundary: Boundary
    lane_type: str | None = None
    predecessors: list[int | str] = []
    successors: list[int | str] = []
    left_neighbor_id: int | str | None = None
    right_neighbor_id: int | str | None = None


class VectorMap(Struct):
    """A map archive; drivable areas are not read."""

    lane_segments: dict[str, LaneSegment]
    pedestrian_crossings: Any = None


def read_av2_map(path: str | Path, location: str = "") -> Log:
    """The map in a map archive of Argoverse 2: a log of one step without objects.

    Args:
      location: ``LogMetadata.location_cluster``; the id of the log by default.

    Raises:
      ValueError: naming the file and the field, what is wrong with it and what to do.
    """
    path = Path(path)
    data = read_file_bytes(path)
    content = parse_document(data, VectorMap, path, _CURE)
    name = path.name.removesuffix(".json").removeprefix(_PREFIX).partition("___")[0]
    unknown: Counter[str] = Counter()
    with naming_file(path):
        if not content.lane_segments:
            raise ValueError(f"it has no lane_segments: {_CURE}")
        segments = {str(segment.id): segment for segment in content.lane_segments.values()}
        if len(segments) < len(content.lane_segments):
            raise ValueError(f"two lane_segments have the same id: {_CURE}")
        crossings = len(content.pedestrian_crossings or ())
        map = Map(
            lanes=tuple(_av2_lane(name, segment, segments, unknown) for name, segment in segments.items()),
            metadata=LogMetadata(
                domain=AV2_DOMAIN,
                scene_id=name,
                location_cluster=location or name,
                variant="av2 map archive",
                source_file=str(path),
                source_sha256=hashlib.sha256(data).hexdigest(),
                unknown_words=dict(sorted(unknown.items())),
                notes={"pedestrian crossings, not read": crossings} if crossings else {},
            ),
        )
        return validate_log(map_to_log(map))


def _av2_lane(name: str, segment: LaneSegment, segments: dict[str, LaneSegment], unknown: Counter[str]) -> MapLane:
    left, right = (
        np.array([[point.x, point.y, point.z] for point in bound], np.float64)
        for bound in (segment.left_lane_boundary, segment.right_lane_boundary)
    )
    points = middle_line(left, right)
    if np.isnan(points[:, 2]).any():
        points[:, 2] = np.nan
    word = segment.lane_type
    return MapLane(
        id=name,
        lane_type=None if word is None else look_up(LANE_WORDS, word, None, "lane type", unknown),
        points=points,
        predecessors=tuple(map(str, segment.predecessors)),
        successors=tuple(map(str, segment.successors)),
        left_neighbors=_av2_neighbors(segment.left_neighbor_id, segments),
        right_neighbors=_av2_neighbors(segment.right_neighbor_id, segments),
    )


def _av2_neighbors(name: int | str | None, segments: dict[str, LaneSegment]) -> tuple[LaneNeighbor, ...]:
    """Neighbors may be oncoming; the lane graph leaves those out."""
    return (LaneNeighbor(str(name)),) if name is not None and str(name) in segments else ()


def _is_av2_map(head: bytes) -> bool:
    return head.lstrip()[:1] == b"{" and any(
        key in head for key in (b'"lane_segments"', b'"left_lane_boundary"', b'"drivable_areas"')
    )


AV2_MAP = FileFormat("Argoverse 2 map", f"{_PREFIX}*.json", AV2_DOMAIN, _is_av2_map, read_av2_map)
