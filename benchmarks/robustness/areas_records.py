"""Record folders: records as bytes, shards, manifest, captions, token features."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from benchmarks.robustness import damage_bytes, damage_json, names
from benchmarks.robustness.case import SOUND, Case
from benchmarks.robustness.invariants import arrays_fault, scene_fault

_WORDS = ("data", "record")


def records(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Encoded records: their arrays, header and bytes; read in all crops."""
    decode, crop_record, crops = names.get("decode_record"), names.get("sample_scene"), tuple(names.get("Crop"))
    stored = [bytes(data) for data in names.get("open_records")(fixtures / "records", "train")]

    def read(data: bytes) -> list[Any]:
        record = decode(data)
        return [crop_record(record, crop) for crop in crops]

    def check(scenes: list[Any]) -> str | None:
        return next((fault for scene in scenes if (fault := scene_fault(scene))), None)

    for text, data in (*_records(rng, stored), (SOUND, stored[0])):
        yield Case(text, lambda folder, data=data: read(data), check, _WORDS, _writer("record.bin", data))


def _records(rng: np.random.Generator, stored: list[bytes]) -> Iterator[tuple[str, bytes]]:
    for k in range(440):
        data = stored[k % len(stored)]
        header, _ = damage_bytes.safetensors_parts(data)
        arrays = {name: np.array(value) for name, value in sorted(safetensors.numpy.load(data).items())}
        name = list(arrays)[k % len(arrays)]
        text, array = damage_bytes.array_damage(rng, arrays[name])
        try:
            changed = {**arrays, name: np.ascontiguousarray(array)}
            yield f"{name}: {text}", safetensors.numpy.save(changed, header["__metadata__"])
        except Exception:  # no such type in this format
            yield (
                f"{name} is missing",
                safetensors.numpy.save(
                    {key: value for key, value in arrays.items() if key != name}, header["__metadata__"]
                ),
            )
    header, body = damage_bytes.safetensors_parts(stored[0])
    origin = json.loads(header["__metadata__"]["record"])
    for text, changed in damage_json.documents(rng, header, 100):
        yield f"header: {text}", damage_bytes.safetensors_of(changed, body)
    for text, changed in damage_json.documents(rng, origin, 60):
        words = changed.decode("utf-8", "replace")
        packed = json.dumps({**header, "__metadata__": {"record": words}}).encode()
        yield f"origin: {text}", damage_bytes.safetensors_of(packed, body)
    yield from damage_bytes.anywhere(rng, stored[0], 60)
    yield from damage_bytes.anywhere(rng, stored[1 % len(stored)], 60, where=slice(0, 1500))


def _writer(name: str, data: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes(data) and None


def _folder_case(
    text: str, fixtures: Path, name: str, data: bytes | None, read: Callable[[Path], Any], check: Callable[[Any], Any]
) -> Case:
    """A copy of the record folder with one file replaced, or removed (None)."""

    def write(folder: Path) -> None:
        for path in (fixtures / "records").iterdir():
            if path.name != name and not path.name.startswith("."):  # such as the lock of whoever built them
                (folder / path.name).symlink_to(path.resolve())
        if data is not None:
            (folder / name).write_bytes(data)

    return Case(f"{name}: {text}", read, check, (name, "shard", "shards"), write)


def shards(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """ArrayRecord shards that are damaged or missing; every record is read and cropped."""
    open_records, decode, crop_record = (names.get(name) for name in ("open_records", "decode_record", "sample_scene"))
    before = [bytes(data) for data in open_records(fixtures / "records", "train")]

    def read(folder: Path) -> Any:
        source = open_records(folder, "train")
        return [(bytes(data), crop_record(decode(data))) for data in (source[i] for i in range(len(source)))]

    def check(rows: list[tuple[bytes, Any]]) -> str | None:
        if [data for data, _ in rows] != before:
            return f"{len(before)} records became {len(rows)}, or others"
        return next((fault for _, scene in rows if (fault := scene_fault(scene))), None)

    yield _folder_case(SOUND, fixtures, "extra.txt", b"", read, check)
    paths = sorted((fixtures / "records").glob("train-*.arrayrecord"))
    for path in paths:
        data = path.read_bytes()
        fixed = [("missing", None), ("empty", b""), ("doubled", data + data), ("zeros", bytes(len(data)))]
        for text, changed in fixed:
            yield _folder_case(text, fixtures, path.name, changed, read, check)
        for text, changed in damage_bytes.anywhere(rng, data, 130 // len(paths)):
            yield _folder_case(text, fixtures, path.name, changed, read, check)


def descriptions(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """manifest.json, captions and token features."""
    yield from _manifests(rng, fixtures)
    yield from _captions(rng, fixtures)
    yield from _features(rng, fixtures)


def _manifests(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    load_manifest, add_captions = names.get("load_manifest"), names.get("add_captions")

    def read(folder: Path) -> Any:
        manifest = load_manifest(folder)
        for path in folder.glob("captions-*"):
            path.unlink()
        add_captions(folder, progress=False)
        return manifest

    before = json.loads((fixtures / "records/manifest.json").read_text())
    yield _folder_case(SOUND, fixtures, "extra.txt", b"", read, _manifest_fault)
    for text, data in damage_json.documents(rng, before, 170):
        yield _folder_case(text, fixtures, "manifest.json", data, read, _manifest_fault)


def _manifest_fault(manifest: dict[str, Any]) -> str | None:
    for split, entry in manifest["splits"].items():
        if isinstance(entry["records"], bool) or not isinstance(entry["records"], int) or entry["records"] < 0:
            return f"{split} has {entry['records']!r} records"
    if not isinstance(manifest["hash"], str):
        return f"hash is {manifest['hash']!r}"
    if not isinstance(manifest["domains"], list) or not all(isinstance(name, str) for name in manifest["domains"]):
        return f"domains are {manifest['domains']!r}"[:100]
    rows = np.asarray(manifest["counts"], float)
    if rows.size and (rows.ndim != 2 or rows.shape[1] != 4 or not np.isfinite(rows).all() or rows.min() < 0):
        return "counts are no rows of four numbers"
    return arrays_fault(manifest["statistics"])


def _captions(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    read_captions = names.get("read_captions")
    packed = (fixtures / "records/captions-train.jsonl.gz").read_bytes()
    name, lines = "captions-train.jsonl.gz", gzip.decompress(packed).splitlines()

    def read(folder: Path) -> Any:
        return list(read_captions(folder, "train"))

    def check(captions: list[Any]) -> str | None:
        if len(captions) != len(lines) - 1:
            return f"{len(lines) - 1} captions became {len(captions)}"
        for caption in captions:
            texts = caption.texts
            if not all(isinstance(text, str) for text in texts):
                return "a text of a caption is no text"
            if fault := arrays_fault(caption.facts):
                return f"facts: {fault}"
        return None

    yield from _lines(rng, fixtures, name, lines, (50, 50), read, check)


def _lines(
    rng: np.random.Generator,
    fixtures: Path,
    name: str,
    lines: list[bytes],
    numbers: tuple[int, int],
    read: Callable[[Path], Any],
    check: Callable[[Any], str | None],
) -> Iterator[Case]:
    """A file of packed lines, damaged in its first two lines and as a whole; ``numbers`` of inputs for each."""
    yield _folder_case(SOUND, fixtures, "extra.txt", b"", read, check)
    for k in (0, 1):
        for text, data in damage_json.documents(rng, json.loads(lines[k]), numbers[0]):
            content = b"\n".join([*lines[:k], data, *lines[k + 1 :]]) + b"\n"
            yield _folder_case(f"line {k}: {text}", fixtures, name, gzip.compress(content, 1, mtime=0), read, check)
    for text, data in damage_bytes.gzips(rng, b"\n".join(lines) + b"\n", numbers[1]):
        yield _folder_case(text, fixtures, name, data, read, check)


def _features(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    store = names.get("TextStore")

    def read(folder: Path) -> Any:
        features = store(folder, "train")
        texts = [np.asarray(features.texts_of(record)).tolist() for record in range(len(features))]
        return len(features), texts, [np.array(features.features(text)) for row in texts for text in row]

    before = read(fixtures / "records")

    def check(result: tuple[int, list[list[int]], list[np.ndarray]]) -> str | None:
        if result[:2] != before[:2]:
            return "other records or texts than were embedded"
        same = all(np.array_equal(a, b) for a, b in zip(result[2], before[2], strict=True))
        return None if same else "other features than were embedded"

    yield _folder_case(SOUND, fixtures, "extra.txt", b"", read, check)
    with np.load(fixtures / "records/text-train.npz") as file:
        arrays = dict(file)
    for text, data in damage_bytes.npzs(rng, arrays, 80):
        yield _folder_case(text, fixtures, "text-train.npz", data, read, check)
    data = (fixtures / "records/text-train.bin").read_bytes()
    for text, changed in damage_bytes.anywhere(rng, data, 40):
        yield _folder_case(text, fixtures, "text-train.bin", changed, read, check)


def measurements(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Measured attributes."""
    measured = names.get("MeasuredRecords")
    name = "attributes-train.jsonl.gz"
    lines = gzip.decompress((fixtures / "records" / name).read_bytes()).splitlines()
    before = json.loads(lines[1])

    def read(folder: Path) -> Any:
        found = measured(folder, "train")
        return [found[record] for record in range(len(found))]

    def check(found: list[dict[str, Any]]) -> str | None:
        if len(found) != len(lines) - 1 or found[0].keys() != before.keys():
            return "other records or attributes than were measured"
        for key, value in found[0].items():
            if isinstance(before[key], list) != isinstance(value, tuple):
                return f"{key} is {value!r:.60}"
            if isinstance(value, float | int) and not 0 <= value < 1e300:
                return f"{key} is {value!r:.60}"
        return None

    yield from _lines(rng, fixtures, name, lines, (60, 40), read, check)


def copy_fixture(source: Path, folder: Path) -> None:
    """Copies the files of a fixture into a folder."""
    shutil.copytree(source, folder, dirs_exist_ok=True)
