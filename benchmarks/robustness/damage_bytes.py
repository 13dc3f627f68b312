"""Damaged bytes: cut, flipped, inserted, removed; and the insides of gzip, zip, npy and safetensors files."""

from __future__ import annotations

import gzip
import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

Damaged = Iterator[tuple[str, bytes]]


def anywhere(rng: np.random.Generator, data: bytes, number: int, *, where: slice | None = None) -> Damaged:
    """``number`` changes of the bytes in ``where`` (default: all)."""
    low, high, _ = (where or slice(None)).indices(len(data))
    for _ in range(number):
        at = int(rng.integers(low, max(high, low + 1)))
        kind = int(rng.integers(6))
        if kind == 0:
            yield f"cut at byte {at} of {len(data)}", data[:at]
        elif kind == 1:
            bit = int(rng.integers(8))
            changed = bytearray(data)
            if changed:
                changed[min(at, len(data) - 1)] ^= 1 << bit
            yield f"bit {bit} of byte {at} flipped", bytes(changed)
        elif kind == 2:
            extra = rng.bytes(int(rng.integers(1, 64)))
            yield f"{len(extra)} bytes inserted at {at}", data[:at] + extra + data[at:]
        elif kind == 3:
            count = int(rng.integers(1, 64))
            yield f"{count} bytes removed at {at}", data[:at] + data[at + count :]
        elif kind == 4:
            count = int(rng.integers(1, 64))
            noise = rng.bytes(count)
            yield f"{count} bytes of noise at {at}", data[:at] + noise + data[at + count :]
        else:
            count = int(rng.integers(1, 512))
            yield f"{count} zeros at {at}", (data[:at] + bytes(count) + data[at + count :])[: len(data)]


def gzips(rng: np.random.Generator, content: bytes, number: int) -> Damaged:
    """``number`` damaged gzip files; among the first are bombs."""
    good = gzip.compress(content, mtime=0)
    bomb = gzip.compress(bytes(200_000_000), 9, mtime=0)
    spaces = gzip.compress(content[:-1] + b" " * 50_000_000 + content[-1:], 9, mtime=0)
    fixed = [
        ("empty", b""),
        ("not packed", content),
        ("a bomb of 200 MB", bomb),
        ("a bomb of 3 GB in 15 members", bomb * 15),
        ("a bomb of 1 GB of spaces", spaces + gzip.compress(b" " * 50_000_000, mtime=0) * 19),
        ("without its last 8 bytes", good[:-8]),
        ("without its last byte", good[:-1]),
        ("header only", good[:10]),
        ("a zip file", b"PK\x03\x04" + good),
        ("packed twice", gzip.compress(good)),
        ("noise behind it", good + b"noise"),
        ("zeros behind it", good + bytes(64)),
        ("wrong length", good[:-4] + b"\1\2\3\4"),
        ("wrong checksum", good[:-8] + b"\1\2\3\4" + good[-4:]),
        ("another method", good[:2] + b"\7" + good[3:]),
        ("odd flags", good[:3] + b"\xff" + good[4:]),
    ]
    yield from fixed[:number]
    yield from anywhere(rng, good, max(number - len(fixed), 0))


def npz(arrays: Mapping[str, Any], *, compressed: bool = False) -> bytes:
    """An npz file."""
    buffer = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(buffer, **arrays)
    return buffer.getvalue()


def npz_of(members: Mapping[str, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    """A zip file of npy members given as bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as file:
        for name, data in members.items():
            file.writestr(f"{name}.npy", data)
    return buffer.getvalue()


def npy(array: Any) -> bytes:
    """An npy file."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asarray(array), allow_pickle=True)
    return buffer.getvalue()


def npy_header(text: str, data: bytes = b"") -> bytes:
    """An npy file with any header."""
    header = text.encode().ljust(118) + b"\n"
    return b"\x93NUMPY\1\0" + len(header).to_bytes(2, "little") + header + data


HEADERS = (
    "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 9), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (600000000,), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (-1, 9), }",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999999,), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
    "{'descr': '<U100000000', 'fortran_order': False, 'shape': (4,), }",
    "{'descr': [('a', '<f4'), ('b', '<i4')], 'fortran_order': False, 'shape': (3,), }",
    "{'descr': '<f4', 'shape': (3,), }",
    "{'descr': 3, 'fortran_order': 7, 'shape': 'x', }",
    "[" * 100,
    "",
)


def npzs(rng: np.random.Generator, arrays: Mapping[str, Any], number: int) -> Damaged:
    """``number`` npz files with damaged arrays, headers, members and bytes, a third of each."""
    part = number // 3
    yield from _arrays(rng, arrays, number - 2 * part)
    yield from _members(rng, arrays, part)
    data = npz(arrays)
    yield from anywhere(rng, data, part // 2)
    yield from anywhere(rng, data, part - part // 2, where=slice(int(0.9 * len(data)), None))


def _arrays(rng: np.random.Generator, arrays: Mapping[str, Any], number: int) -> Damaged:
    names = list(arrays)
    for k in range(number):
        name = names[k % len(names)]
        text, array = array_damage(rng, np.asarray(arrays[name]))
        yield f"{name}: {text}", npz({**arrays, name: array})


def array_damage(rng: np.random.Generator, array: np.ndarray) -> tuple[str, np.ndarray]:
    """One array with a wrong value, shape or type, and what is wrong."""
    flat = array.copy().reshape(-1)
    kind = int(rng.integers(10))
    if kind <= 3 and flat.size and array.dtype.kind in "fiub":
        odd = {
            "f": [np.nan, np.inf, -np.inf, 1e30, -1e30, -1.0, 0.0, 2e7],
            "i": [-1, 6, 17, 2**31 - 1, -(2**31)],
            "u": [6, 17, 255],
            "b": [True, False],
        }[array.dtype.kind]
        value = odd[rng.integers(len(odd))]
        rows = slice(None) if rng.integers(3) == 0 else rng.integers(flat.size)
        with np.errstate(over="ignore"):
            flat[rows] = np.asarray(value).astype(array.dtype)
        return f"{value} at {'all places' if isinstance(rows, slice) else rows}", flat.reshape(array.shape)
    if kind == 4 and array.ndim:
        return "one row less", array[:-1]
    if kind == 5 and array.ndim:
        return "one row more", np.concatenate([array, array[-1:]])
    if kind == 6:
        return "one axis more", array[None]
    if kind == 7:
        kinds = [np.float64, np.int64, np.int8, bool, "U5", np.complex64, np.float16]
        dtype = kinds[rng.integers(len(kinds))]
        try:
            return f"as {np.dtype(dtype)}", array.astype(dtype)
        except ValueError:
            return "as a word", np.array("word")
    if kind == 8 and array.ndim:
        return "no rows", array[:0]
    if kind == 9 and array.ndim > 1:
        return "transposed", array.T.copy()
    return "permuted", rng.permutation(flat).reshape(array.shape)


def _members(rng: np.random.Generator, arrays: Mapping[str, Any], number: int) -> Damaged:
    members = {name: npy(array) for name, array in arrays.items()}
    names = list(members)
    for k in range(number):
        name, kind = names[int(rng.integers(len(names)))], k % 6
        if kind <= 1:
            header = HEADERS[(k // 6 * 2 + kind) % len(HEADERS)]
            yield f"{name}: header {header[:60]}", npz_of({**members, name: npy_header(header, members[name][128:])})
        elif kind == 2:
            yield f"{name} is missing", npz_of({key: value for key, value in members.items() if key != name})
        elif kind == 3:
            text, data = next(anywhere(rng, members[name], 1, where=slice(0, 128)))
            yield f"{name}: {text}", npz_of({**members, name: data})
        elif kind == 4:
            methods = (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
            data = npz_of({**members, name: members[name] + bytes(100_000_000 if k < 20 else 100)}, methods[k % 3])
            yield f"{name}: zeros behind it, packed", data
        else:
            packed = bytearray(npz_of(members))
            start = packed.find(b"PK\1\2") if rng.integers(2) else 0
            at = start + int(rng.integers(4, 30))
            packed[at] = int(rng.integers(256))
            yield f"byte {at} of a zip header is {packed[at]}", bytes(packed)


def safetensors_parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Header and body of a safetensors file."""
    size = int.from_bytes(data[:8], "little")
    return json.loads(data[8 : 8 + size]), data[8 + size :]


def safetensors_of(header: bytes, body: bytes, size: int | None = None) -> bytes:
    """A safetensors file with any header."""
    return (len(header) if size is None else size).to_bytes(8, "little") + header + body
