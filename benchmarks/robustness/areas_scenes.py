"""Scenes and logs in files: recorded scenes, scjax's own JSON and npz, and logs."""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import damage_bytes, damage_json, names
from benchmarks.robustness.case import SOUND, Case
from benchmarks.robustness.invariants import log_fault, old_log_fault, scene_fault


def _plain(data: bytes) -> Any:
    """A JSON text whose whole numbers may have any number of digits; Python refuses those of more than 4,300."""
    return json.loads(data, parse_int=lambda digits: int(digits) if len(digits) < 400 else float("inf"))


def file_case(text: str, name: str, data: bytes, read: Callable[[Path], Any], check: Callable[[Any], Any]) -> Case:
    """A case of one damaged file, which a refusal must name."""
    return Case(text, lambda folder: read(folder / name), check, (name,), lambda folder: _write(folder / name, data))


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def recorded(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Scenes in the format scene-json-1: documents with other values, and damaged gzip files."""
    read = names.get("read_recorded")
    check = old_log_fault if names.is_old() else log_fault
    document = json.loads(gzip.decompress((fixtures / "recorded.json.gz").read_bytes()))
    for text, data in damage_json.documents(rng, document, 860):
        yield file_case(
            text,
            "scene-7.json.gz",
            gzip.compress(data, 1, mtime=0),
            read,
            lambda log, data=data: check(log) or _recorded_unlike(log, _plain(data)),
        )
    for text, data in damage_bytes.gzips(rng, json.dumps(document).encode(), 100):
        yield file_case(text, "scene-7.json.gz", data, read, check)
    yield file_case(SOUND, "scene-7.json.gz", (fixtures / "recorded.json.gz").read_bytes(), read, check)


def own_json(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Scenes in scjax's own JSON; an accepted scene must say what the document says."""
    read = names.get("load_json")
    for name, number in (("scene", 560), ("batch", 200)):
        document = json.loads((fixtures / f"{name}.json").read_text())
        damaged = damage_json.documents(rng, document, number)
        for text, data in (*damaged, (SOUND, damage_json.dump(document))):
            yield file_case(
                text, "my-scene.json", data, read, lambda scene, data=data: scene_fault(scene) or _unlike(scene, data)
            )


def own_npz(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Scenes in scjax's own npz."""
    read = names.get("load_npz")
    for name, number in (("scene", 420), ("batch", 120)):
        with np.load(fixtures / f"{name}.npz") as file:
            arrays = dict(file)
        for text, data in (*damage_bytes.npzs(rng, arrays, number), (SOUND, damage_bytes.npz(arrays))):
            yield file_case(text, "my-scene.npz", data, read, scene_fault)


def logs(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Logs in npz: their arrays, and the JSON in their header."""
    read = names.get("load_log")
    with np.load(fixtures / "log.npz") as file:
        arrays = dict(file)
    for text, data in (*damage_bytes.npzs(rng, arrays, 180), (SOUND, damage_bytes.npz(arrays))):
        yield file_case(text, "my-log.npz", data, read, log_fault)
    header = json.loads(str(arrays["header"]))
    for text, data in damage_json.documents(rng, header, 120):
        if len(data) < 1_000_000:
            word = np.array(data.decode("utf-8", "replace"))
            changed = damage_bytes.npz({**arrays, "header": word}, compressed=True)
            yield file_case(f"header: {text}", "my-log.npz", changed, read, log_fault)


def _recorded_unlike(log: Any, document: dict[str, Any]) -> str | None:
    """How a log differs from the recording it was read from; numbers may be written as texts."""
    objects, steps = document["objects"], document["timestamps"]
    if (len(objects), len(steps)) != log.valid.shape:
        return f"{len(objects)} objects and {len(steps)} steps became {log.valid.shape}"
    lanes = [item for item in document["map"] if item["type"] == "lane"]
    if [len(item["x"]) for item in lanes] != [len(lane.points) for lane in log.lanes]:
        return "other lanes, or lanes of other lengths"
    for i, item in enumerate(objects):
        for key, values in (
            ("x", log.positions[i, :, 0]),
            ("vy", log.velocities[i, :, 1]),
            ("heading", log.headings[i]),
        ):
            stated = np.array([np.nan if value is None else float(value) for value in item[key]])
            if not np.allclose(stated[log.valid[i]], values[log.valid[i]], equal_nan=True):
                return f"{key} of object {i} differs"
    for item, lane in zip(lanes, log.lanes, strict=True):
        if not np.allclose([float(value) for value in item["y"]], lane.points[:, 1]):
            return "y of a lane differs"
    return None


def _unlike(scene: Any, data: bytes) -> str | None:
    """How a scene differs from the JSON document it was read from, None if it does not."""
    document = _plain(data)
    items, flat = document["scenes"], scene if scene.batch_shape else None
    number = math.prod(scene.batch_shape)
    if len(items) != number:
        return f"{len(items)} scenes became {number}"
    arrays = {name: np.asarray(value) for name, value in scene.to_dict().items()}
    if flat is not None:
        lead = len(scene.batch_shape)
        arrays = {name: value.reshape(number, *value.shape[lead:]) for name, value in arrays.items()}
    else:
        arrays = {name: value[None] for name, value in arrays.items()}
    for i, item in enumerate(items):
        one = {name: value[i] for name, value in arrays.items()}
        if fault := _agents_unlike(one, item["agents"]) or _lanes_unlike(one, item["lanes"]):
            return f"scene {i}: {fault}"
    return None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} was read as a number")
    return float(value)


def _agents_unlike(arrays: dict[str, np.ndarray], agents: list[dict[str, Any]]) -> str | None:
    mask = arrays["agent_mask"]
    if len(agents) != mask.sum():
        return f"{len(agents)} agents became {mask.sum()}"
    for key, column in (("x", 0), ("y", 1), ("speed", 3), ("length", 6), ("width", 7)):
        # A value that is listed as unknown, or left out, may be filled.
        filled = any(key in (agent.get("unknown") or ()) or agent.get(key) is None for agent in agents)
        values = sorted(_number(agent[key]) for agent in agents if agent.get(key) is not None)
        if not filled and not np.allclose(values, np.sort(arrays["agents"][mask, column]), rtol=1e-5, atol=1e-5):
            return f"{key} of agents differs"
    angles = [_number(agent["heading"]) for agent in agents if agent.get("heading") is not None]
    if len(angles) == len(agents):
        for function, column in ((np.cos, 4), (np.sin, 5)):
            if not np.allclose(np.sort(function(angles)), np.sort(arrays["agents"][mask, column]), atol=1e-4):
                return "heading of agents differs"
    return None


def _lanes_unlike(arrays: dict[str, np.ndarray], lanes: list[dict[str, Any]]) -> str | None:
    mask = arrays["lane_mask"]
    if len(lanes) != mask.sum():
        return f"{len(lanes)} lanes became {mask.sum()}"
    for end in (0, -1):  # a resampled line keeps its ends
        ends = sorted([_number(value) for value in lane["points"][end][:2]] for lane in lanes)
        points = sorted(arrays["lanes"][mask, end, :2].tolist())
        if not np.allclose(np.sort(ends, 0), np.sort(points, 0), rtol=1e-5, atol=1e-4):
            return "ends of lanes differ"
    successors = {(lane["id"], other) for lane in lanes for other in (lane.get("successors") or ())}
    pairs = mask[:, None] & mask[None]
    if len(successors) != ((arrays["links"] == 1) & pairs).sum():
        return f"{len(successors)} successors became {((arrays['links'] == 1) & pairs).sum()}"
    return None
