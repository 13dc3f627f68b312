"""Scenes in files: ``.npz`` (exact, fast) and JSON (readable, writable by hand); single scenes or batches."""

from __future__ import annotations

import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from scjax.scene import POINTS_PER_LANE, STATE_COLUMNS, AgentType, Crop, Link, Scene, Signal, empty, stack, validate
from scjax.scene.files import write_file, write_text

NPZ_VERSION = 1
JSON_FORMAT, JSON_VERSION = "scjax-scene", 1
_UNITS = {"x, y, z, length, width, height": "m", "speed": "m/s", "heading": "rad, counter-clockwise from +x"}
_DIGITS = 7  # float32 holds about seven
# Files keep the names of their first version, which other programs read: "layout" is the crop. Both are read.
_FILE_NAMES = {"crop": "layout"}
_FILE_CROPS = {"centered": "centred"}
_FIELD_NAMES = {file_name: name for name, file_name in _FILE_NAMES.items()}
_CROP_NAMES = {file_name: name for name, file_name in _FILE_CROPS.items()}


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
    path = Path(path)
    try:
        with open(path, "rb") as handle, np.load(handle, allow_pickle=False) as file:
            arrays = {_FIELD_NAMES.get(name, name): file[name] for name in file.files}
    except FileNotFoundError:
        raise
    except (OSError, EOFError, ValueError, AttributeError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no readable .npz scene ({error}): it may be cut short, write it again") from error
    _check_version(path, arrays.pop("format_version", None), NPZ_VERSION)
    missing = [_FILE_NAMES.get(name, name) for name in empty(0, 0).to_dict() if name not in arrays]
    if missing:
        raise ValueError(f"{path} lacks the arrays {sorted(missing)}: write it with scjax.scene.io.save_npz")
    fields = empty(0, 0).to_dict()
    for name, field in fields.items():
        if arrays[name].dtype.kind != field.dtype.kind:
            raise ValueError(f"{path}: {name} is {arrays[name].dtype}, not {field.dtype}: write it with save_npz")
    return _validated(path, Scene(**{name: arrays[name] for name in fields}))


def save_json(scene: Scene, path: str | Path) -> None:
    """Writes ``scene_to_json(scene)`` to a temporary name, then renames it."""
    write_text(Path(path), scene_to_json(scene))


def load_json(path: str | Path) -> Scene:
    """Reads a file of the form that ``scene_to_json`` makes.

    Raises:
      FileNotFoundError: if there is no such file.
      ValueError: as ``scene_from_json``; names the file.
    """
    return scene_from_json(Path(path).read_text(encoding="utf-8"), name=str(path))


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
        "units": _UNITS,
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
    ids), ``signal`` (unknown), the lists of neighbors and ``unknown`` (empty).

    Raises:
      ValueError: on text that is no JSON, another version, or a missing or wrong field; starts with ``name``.
    """
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{name} is no JSON ({error}): it may be cut short, write it again") from error
    if not isinstance(data, dict) or data.get("format") != JSON_FORMAT:
        raise ValueError(
            f'{name} is no scene: it must be an object with "format": "{JSON_FORMAT}" (scjax.scene.io.scene_to_json)'
        )
    _check_version(name, data.get("version"), JSON_VERSION)
    items = _field(data, "scenes", name)
    lead = tuple(data.get("batch_shape", [len(items)]))
    if math.prod(lead) != len(items):
        raise ValueError(f"{name}: batch_shape {list(lead)} does not fit {len(items)} scenes: correct one of them")
    slots = (data.get("agent_slots", 0), data.get("lane_slots", 0), data.get("points_per_lane", POINTS_PER_LANE))
    if not items:
        fields = _blank(*slots).to_dict().items()
        return Scene(**{field: np.zeros((*lead, *value.shape), value.dtype) for field, value in fields})
    batch = stack([_read_scene(item, slots, f"{name}, scene {i}") for i, item in enumerate(items)])
    shaped = {field: value.reshape((*lead, *value.shape[1:])) for field, value in batch.to_dict().items()}
    return _validated(name, Scene(**shaped))


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


def _read_scene(data: dict, slots: tuple[int, int, int], name: str) -> Scene:
    agents, lanes = _field(data, "agents", name), _field(data, "lanes", name)
    num_agents = max([slots[0], *(_id(agent, f"{name}, agents") + 1 for agent in agents)])
    num_lanes = max([slots[1], *(_id(lane, f"{name}, lanes") + 1 for lane in lanes)])
    word = data.get("layout", data.get("crop", "centred"))
    crop = _enum(Crop, _CROP_NAMES.get(word, word), f"{name}, layout")
    scene = _blank(num_agents, num_lanes, slots[2], Crop(crop), data.get("domain", 0))
    for agent in agents:
        i, where = agent["id"], f"{name}, agent {agent['id']}"
        _take_slot(scene.agent_mask, i, where)
        heading = _value(agent, "heading", where)
        state = {column: _value(agent, column, where) for column in STATE_COLUMNS if column not in ("cos", "sin")}
        state |= {"cos": math.cos(heading), "sin": math.sin(heading)}
        scene.agents[i] = [state[column] for column in STATE_COLUMNS]
        scene.agent_types[i] = _enum(AgentType, _field(agent, "type", where), where)
        scene.agent_known[i] = _known(agent, STATE_COLUMNS, where)
    for lane in lanes:
        i, where = lane["id"], f"{name}, lane {lane['id']}"
        _take_slot(scene.lane_mask, i, where)
        points = _points(_field(lane, "points", where), where)
        if points.shape != (slots[2], 3):
            raise ValueError(f"{where} has points of shape {list(points.shape)}: give {slots[2]} points of x, y, z")
        scene.lanes[i] = points
        scene.signals[i] = _enum(Signal, lane.get("signal", "unknown"), where)
        scene.lane_known[i] = _known(lane, ("x", "y", "z"), where)
        scene.links[i, i] = Link.SELF
    for lane in lanes:
        _read_links(scene, lane, f"{name}, lane {lane['id']}")
    return scene


def _blank(agents: int, lanes: int, points: int, crop: Crop = Crop.CENTERED, domain: int = 0) -> Scene:
    """Padding only, with ``points`` points per lane."""
    arrays = empty(agents, lanes, crop=crop, domain=domain).to_dict()
    return Scene(**{**arrays, "lanes": np.zeros((lanes, points, 3), np.float32)})


def _read_links(scene: Scene, lane: dict, where: str) -> None:
    """``successors`` of i: PREDECESSOR in row i. ``left`` of i names j: j is the left neighbor, LEFT in row j."""
    i = lane["id"]
    for key, inverse, link in (
        ("successors", Link.SUCCESSOR, Link.PREDECESSOR),
        ("left", Link.LEFT, Link.RIGHT),
        ("right", Link.RIGHT, Link.LEFT),
    ):
        for j in lane.get(key, []):
            if not (isinstance(j, int) and 0 <= j < len(scene.lane_mask) and scene.lane_mask[j] and j != i):
                raise ValueError(f"{where}: {key} names {j!r}, which is not the id of another lane: correct it")
            if scene.links[i, j] == link:
                continue
            # A ring of two lanes is the one pair that may hold the same relation, PREDECESSOR, both ways.
            ring = link == Link.PREDECESSOR and scene.links[i, j] == Link.SUCCESSOR
            if not ring and scene.links[i, j] != Link.NONE:
                raise ValueError(f"{where}: {key} names {j}, which is linked to it in another way as well: keep one")
            scene.links[i, j], scene.links[j, i] = link, Link.PREDECESSOR if ring else inverse


def _number(value: Any) -> float:
    return round(float(value), _DIGITS)


def _field(data: Any, key: str, where: str) -> Any:
    if not isinstance(data, dict) or key not in data:
        raise ValueError(f"{where}: the field {key!r} is missing: see scjax.scene.io.scene_to_json for the format")
    return data[key]


def _id(data: dict, where: str) -> int:
    value = _field(data, "id", where)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{where}: the id {value!r} is no whole number of at least 0")
    return value


def _value(data: dict, key: str, where: str) -> float:
    value = _field(data, key, where)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{where}: {key} is {value!r}, not a number")
    return float(value)


def _points(rows: Any, where: str) -> np.ndarray:
    try:
        return np.asarray(rows, np.float32)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: points must be a list of [x, y, z] numbers ({error})") from error


def _enum(enum_type: Any, word: Any, where: str) -> int:
    words = [member.name.lower() for member in enum_type]
    if word not in words:
        raise ValueError(f"{where}: {word!r} is no {enum_type.__name__}: choose one of {words}")
    return words.index(word)


def _known(data: dict, columns: tuple[str, ...], where: str) -> list[bool]:
    unknown = data.get("unknown", [])
    if invalid := set(unknown) - set(columns):
        raise ValueError(f"{where}: unknown names {sorted(invalid)}, which are no columns: choose from {list(columns)}")
    return [column not in unknown for column in columns]


def _take_slot(mask: Any, i: Any, where: str) -> None:
    """Marks slot ``i`` as real; ValueError if it is already."""
    if mask[i]:
        raise ValueError(f"{where}: the id is used twice: ids must differ")
    mask[i] = True


def _check_version(name: str | Path, version: Any, supported: int) -> None:
    if version is None:
        raise ValueError(f"{name} has no format version: it was not written by scjax.scene.io: write it again")
    if int(version) != supported:
        raise ValueError(f"{name} has format version {int(version)}, this scjax reads {supported}: update or re-export")


def _validated(name: str | Path, scene: Scene) -> Scene:
    try:
        return validate(scene)
    except ValueError as error:
        raise ValueError(f"{name} holds an invalid scene: {error}") from error
