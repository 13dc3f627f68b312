"""Files that people have -> ``Map`` or ``Log``: the format is found by content, whatever a file is called."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

from scjax.data.readers import FORMATS
from scjax.data.readers.base import FileFormat
from scjax.data.readers.scene_json import SCHEMA, read_log
from scjax.scene import Log, Map, Scene, io, load_log, load_map, log_to_map, map_to_log, scene_to_map
from scjax.scene.log_io import LOG_FORMAT
from scjax.scene.map_io import MAP_FORMAT
from scjax.scene.npz import read_npz
from scjax.scene.scene_document import JSON_FORMAT

HEAD_BYTES = 200_000
_OTHERS = {
    b"<OpenSCENARIO": "OpenSCENARIO",
    b"<net ": "SUMO",
    b"PAR1": "Parquet",
    b"commonroad": "CommonRoad in protobuf",
}
OWN_FORMATS = ("scene", "map", "log", "recording")
"""Kinds of scjax's own files; all other formats have the names of ``scjax.data.readers.FORMATS``."""


def find_format(path: str | Path) -> str:
    """The format of a file by its content: one of ``OWN_FORMATS``, or a name in ``FORMATS``.

    Raises:
      ValueError: there is no such file, or it is of no known format; names those that are.
    """
    path = Path(path)
    head = _read_head(path)
    if head[:4] == b"PK\x03\x04":
        return _npz_kind(path)
    for word, kind in ((JSON_FORMAT, "scene"), (MAP_FORMAT, "map"), (SCHEMA, "recording")):
        if head.lstrip()[:1] == b"{" and f'"{word}"'.encode() in head:
            return kind
    for entry in FORMATS:
        if entry.matches(head):
            return entry.name
    if path.name.endswith((".json", ".json.gz")):  # their readers say what is missing
        return "recording" if path.suffix == ".gz" else "scene"
    other = next((f" (it looks like {name})" for word, name in _OTHERS.items() if word in head[:2000]), "")
    known = ", ".join(entry.name for entry in FORMATS)
    raise ValueError(
        f"{path}: of no known format{other}: scjax reads {known}, and scenes, maps, logs and recordings of its own "
        "(docs/maps.md)"
    )


def read_any(path: str | Path) -> Scene | Log | Map:
    """What a file of any format holds.

    Raises:
      ValueError: naming the file: it is of no known format, or damaged; says what to do.
    """
    path = Path(path)
    kind = find_format(path)
    if kind == "scene":
        return io.load_json(path) if _read_head(path)[:4] != b"PK\x03\x04" else io.load_npz(path)
    own = {"map": load_map, "log": load_log, "recording": read_log}
    if kind in own:
        return own[kind](path)
    return _format_of(kind).read(path, "")


def import_map(path: str | Path, step: int = 0) -> Map:
    """The map in a file of any format: OpenDRIVE, CommonRoad, Lanelet2, ScenarioNet, Argoverse 2, or scjax's own.

    Args:
      step: of a recording; signals and agents are as they are then.

    Raises:
      ValueError: naming the file: it is of no known format, damaged, or has no such step; says what to do.
    """
    return map_of_content(read_any(path), path, step)


def map_of_content(content: Scene | Log | Map, path: str | Path, step: int = 0) -> Map:
    """What ``read_any`` gave, as a map; arguments and errors as ``import_map``."""
    if isinstance(content, Map):
        return content
    if isinstance(content, Scene):
        if content.batch_shape:
            raise ValueError(f"{path}: it holds several scenes: a map is made of one, use scjax.scene.scene_to_map")
        return scene_to_map(content)
    try:
        return log_to_map(content, step)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def import_log(path: str | Path) -> Log:
    """The log in a file of any format. A map gives a log of one step.

    Raises:
      ValueError: naming the file: it is of no known format, damaged, or a scene; says what to do.
    """
    content = read_any(path)
    if isinstance(content, Scene):
        raise ValueError(f"{path}: it holds scenes, which have no time: read it with scjax.scene.io")
    return map_to_log(content) if isinstance(content, Map) else content


def _format_of(name: str) -> FileFormat:
    return next(entry for entry in FORMATS if entry.name == name)


def _read_head(path: Path) -> bytes:
    """The first bytes of a file, decompressed if it is gzip."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        if head[:2] != b"\x1f\x8b":
            return head
        with gzip.open(path, "rb") as file:
            return file.read(HEAD_BYTES)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ValueError(f"{path}: not a complete gzip file ({error}): copy or download it again") from error
    except FileNotFoundError as error:
        raise ValueError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise ValueError(f"{path}: is a folder, not a file") from error


def _npz_kind(path: Path) -> str:
    """What an npz file of scjax holds, by the header that logs and maps have."""
    header = str(read_npz(path, {"header": "U"}, "write it again", optional=frozenset({"header"})).get("header", ""))
    return "map" if f'"{MAP_FORMAT}"' in header else "log" if f'"{LOG_FORMAT}"' in header else "scene"
