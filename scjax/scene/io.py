"""Scenes in files: ``.npz`` (exact, fast) and JSON (readable, writable by hand); single scenes or batches."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from scjax.scene import STATE_COLUMNS, AgentType, Crop, Link, Scene, Signal, empty, validate
from scjax.scene.document import parse_document
from scjax.scene.files import read_limited, write_file, write_text
from scjax.scene.npz import read_npz
from scjax.scene.scene_document import JSON_FORMAT, JSON_VERSION, UNITS, FileVersion, SceneFile, scenes_of

NPZ_VERSION = 1
_DIGITS = 7  # float32 holds about seven
# Files keep the names of their first version, which other programs read: "layout" is the crop. Both are read.
_FILE_NAMES = {"crop": "layout"}
_FILE_CROPS = {"centered": "centred"}
_CURE = "see docs/scene-json.md for the form"


def save_npz(scene: Scene, path: str | Path) -> None:
    """Writes every array of ``scene`` (single or batch), exactly, to a temporary name first.

    Raises:
      ValueError: if the scene breaks an invariant (``scjax.scene.validate``).
    """
    arrays = {_FILE_NAMES.get(name, name): array for name, array in validate(scene.to_numpy()).to_dict().items()}
    write_file(Path(path), lambda file: np.savez(file, allow_pickle=False, format_version=NPZ_VERSION, **arrays))


def load_npz(path: str | Path) -> Scene:
    """Reads what ``save_npz`` wrote, as NumPy arrays.

    Raises:
      FileNotFoundError: if there is no such file.
      ValueError: on a damaged file, another version, missing arrays or an invalid scene; names the file.
    """
    fields = empty(0, 0).to_dict()
    kinds = {_FILE_NAMES.get(name, name): field.dtype.kind for name, field in fields.items()}
    both = {"layout": "i", "crop": "i"}
    arrays = read_npz(
        path,
        {"format_version": "iu", **kinds, **both},
        "write it with scjax.scene.io.save_npz",
        optional=frozenset({"format_version", *both}),
    )
    _check_version(path, arrays.pop("format_version", None), NPZ_VERSION)
    crops = [arrays.pop(name) for name in both if name in arrays]
    if not crops:
        raise ValueError(f"{path} lacks the array 'layout': write it with scjax.scene.io.save_npz")
    return _validated(path, Scene(**arrays, crop=crops[0]))


def save_json(scene: Scene, path: str | Path) -> None:
    """Writes ``scene_to_json(scene)`` to a temporary name, then renames it."""
    write_text(Path(path), scene_to_json(scene))


def load_json(path: str | Path) -> Scene:
    """Reads a file of the form that ``scene_to_json`` makes.

    Raises:
      FileNotFoundError: if there is no such file.
      ValueError: as ``scene_from_json``; names the file.
    """
    return _scene_from_bytes(read_limited(path), str(path))


def scene_to_json(scene: Scene) -> str:
    """``scene`` (single or batch) as text: one line per agent or lane, with named fields and enums as words.

    An id is the slot in the scene's arrays; ``successors``, ``left`` and ``right`` name lanes by id. ``unknown`` lists
    the state columns that were filled, not recorded. Numbers are rounded to 1e-7; headings are stored as angles.

    Raises:
      ValueError: if the scene breaks an invariant (``scjax.scene.validate``).
    """
    host = validate(scene.to_numpy())
    lead = host.batch_shape
    flat = {name: value.reshape(math.prod(lead), *value.shape[len(lead) :]) for name, value in host.to_dict().items()}
    single = [Scene(**{name: np.asarray(value[i]) for name, value in flat.items()}) for i in range(math.prod(lead))]
    header = {
        "format": JSON_FORMAT,
        "version": JSON_VERSION,
        "units": UNITS,
        "batch_shape": list(lead),
        "agent_slots": host.agent_mask.shape[-1],
        "lane_slots": host.lane_mask.shape[-1],
        "points_per_lane": host.lanes.shape[-2],
    }
    scenes = ",\n".join(_scene_text(scene) for scene in single)
    return json.dumps(header)[:-1] + f', "scenes": [\n{scenes}\n]}}\n'


def scene_from_json(text: str, *, name: str = "the text") -> Scene:
    """The scene, or batch of scenes, in a text that ``scene_to_json`` wrote, as NumPy arrays.

    A text written by hand may leave out ``batch_shape`` (default: a list of scenes), the slots (as many as there are
    elements), ``signal`` (unknown), the lists of neighbors and ``unknown`` (empty). Ids are any distinct whole numbers
    or strings. Lanes have any number of points, with or without z (docs/scene-json.md).

    Raises:
      ValueError: on text that is no JSON, another version, or a missing or wrong field; starts with ``name``.
    """
    try:
        data = text.encode()
    except UnicodeEncodeError as error:
        raise ValueError(f"{name} holds characters that are no text ({error}): write it in UTF-8") from error
    return _scene_from_bytes(data, name)


def _scene_from_bytes(data: bytes, name: str) -> Scene:
    header = parse_document(data, FileVersion, name, _CURE)
    if header.format != JSON_FORMAT:
        raise ValueError(
            f'{name} is no scene: it must be an object with "format": "{JSON_FORMAT}" (scjax.scene.io.scene_to_json)'
        )
    _check_version(name, header.version, JSON_VERSION)
    return _validated(name, scenes_of(parse_document(data, SceneFile, name, _CURE), name, len(data)))


def _scene_text(scene: Scene) -> str:
    agents = [
        {
            "id": int(i),
            "type": AgentType(int(scene.agent_types[i])).name.lower(),
            **{column: _number(value) for column, value in zip(STATE_COLUMNS[:4], scene.agents[i, :4], strict=True)},
            "heading": _number(np.arctan2(*scene.agents[i, 5:3:-1].astype(np.float64))),
            **{column: _number(value) for column, value in zip(STATE_COLUMNS[6:], scene.agents[i, 6:], strict=True)},
            "unknown": [STATE_COLUMNS[c] for c in np.flatnonzero(~scene.agent_known[i])],
        }
        for i in np.flatnonzero(scene.agent_mask)
    ]
    lanes = [
        {
            "id": int(i),
            "signal": Signal(int(scene.signals[i])).name.lower(),
            "successors": np.flatnonzero(scene.links[i] == Link.PREDECESSOR).tolist(),
            "left": np.flatnonzero(scene.links[:, i] == Link.LEFT).tolist(),
            "right": np.flatnonzero(scene.links[:, i] == Link.RIGHT).tolist(),
            "unknown": ["xyz"[c] for c in np.flatnonzero(~scene.lane_known[i])],
            "points": [[_number(value) for value in point] for point in scene.lanes[i]],
        }
        for i in np.flatnonzero(scene.lane_mask)
    ]
    rows = {"agents": agents, "lanes": lanes}
    lists = ", ".join(f'"{key}": [' + ",".join(f"\n  {json.dumps(row)}" for row in rows[key]) + "]" for key in rows)
    crop = Crop(int(scene.crop)).name.lower()
    return f' {{"layout": "{_FILE_CROPS.get(crop, crop)}", "domain": {int(scene.domain)}, {lists}}}'


def _number(value: Any) -> float:
    return round(float(value), _DIGITS)


def _check_version(name: str | Path, version: Any, supported: int) -> None:
    if version is None:
        raise ValueError(f"{name} has no format version: it was not written by scjax.scene.io: write it again")
    if isinstance(version, np.ndarray):
        version = version.tolist()[:3] if version.ndim else version.item()
    if isinstance(version, bool) or version != supported:
        raise ValueError(f"{name} has format version {version!r}, this scjax reads {supported}: update or re-export")


def _validated(name: str | Path, scene: Scene) -> Scene:
    try:
        return validate(scene)
    except ValueError as error:
        raise ValueError(f"{name} holds an invalid scene: {error}") from error
