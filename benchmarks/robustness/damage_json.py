"""Damaged JSON documents: other types and values at every place, and other keys, lists and texts."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.robustness import damage_bytes

_RAW = {  # place holder -> text that json.dumps cannot write
    "@deep list@": "[" * 3000 + "]" * 3000,
    "@deeper list@": "[" * 200_000,
    "@deep object@": '{"a":' * 3000 + "1" + "}" * 3000,
    "@5000 digits@": "9" * 5000,
}
VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    "",
    "word",
    "3",
    "\ud800",
    [],
    {},
    [[1]],
    {"a": 1},
    [None],
    0,
    -1,
    0.5,
    3.0,
    1e30,
    -1e30,
    float("nan"),
    float("inf"),
    -float("inf"),
    2**31,
    2**63,
    10**300,
    10**400,
    3_000_000_000,
    "x" * 100_000,
    *_RAW,
)
Path = tuple[str | int, ...]


def dump(document: Any) -> bytes:
    """``document`` as JSON; place holders become what they stand for."""
    text = json.dumps(document)
    for name, raw in _RAW.items():
        text = text.replace(json.dumps(name), raw)
    return text.encode()


def show(value: Any) -> str:
    """A short text for a value."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**30:
        return f"{len(str(value))} digits"
    text = ascii(value)
    return text if len(text) < 60 else f"{text[:40]}... ({len(text)} characters)"


def show_path(path: Path) -> str:
    """A short text for a path."""
    return ".".join(map(str, path)) or "the document"


def field_names(text: str) -> tuple[str, ...]:
    """The two innermost fields that the text of a damage speaks of, if their names differ from other words."""
    path = re.match(r"(?:[\w ./,-]+: )*([\w.]+)(?: = | is | holds )", text)
    keys = [key for key in path[1].split(".") if not key.isdigit() and len(key) > 2] if path else []
    return tuple(keys[-2:])


def places(document: Any, path: Path = ()) -> Iterator[Path]:
    """Paths of all nodes; of a list the first, the middle and the last item."""
    yield path
    if isinstance(document, dict):
        for key in document:
            yield from places(document[key], (*path, key))
    elif isinstance(document, list) and document:
        for i in sorted({0, len(document) // 2, len(document) - 1}):
            yield from places(document[i], (*path, i))


def at(document: Any, path: Path) -> Any:
    """The node at a path."""
    for step in path:
        document = document[step]
    return document


def replaced(document: Any, path: Path, value: Any) -> Any:
    """A copy of ``document`` with another value at a path."""
    if not path:
        return value
    result = copy.deepcopy(document)
    at(result, path[:-1])[path[-1]] = value
    return result


def _removed(document: Any, path: Path) -> Any:
    result = copy.deepcopy(document)
    del at(result, path[:-1])[path[-1]]
    return result


def values(rng: np.random.Generator, document: Any, number: int) -> Iterator[tuple[str, Any]]:
    """``number`` documents with another value at one place; every kind of place gets as many values as possible."""
    kinds: dict[Path, list[Path]] = {}
    for path in places(document):
        kinds.setdefault(tuple("*" if isinstance(step, int) else step for step in path), []).append(path)
    pairs = [(kind, k) for kind in kinds for k in range(len(VALUES))]
    rng.shuffle(pairs)
    while len(pairs) < number:
        pairs = pairs + pairs
    for kind, k in pairs[:number]:
        path = kinds[tuple(kind)][rng.integers(len(kinds[tuple(kind)]))]
        yield f"{show_path(path)} = {show(VALUES[k])}", replaced(document, path, VALUES[k])


def structures(rng: np.random.Generator, document: Any, number: int) -> Iterator[tuple[str, Any]]:
    """``number`` documents with a key or item that is missing, extra, renamed, repeated, or at another place."""
    paths = [path for path in places(document) if path]
    for _ in range(number):
        path = paths[rng.integers(len(paths))]
        parent, name = at(document, path[:-1]), show_path(path)
        kind = int(rng.integers(5))
        if kind == 0:
            yield f"{name} is missing", _removed(document, path)
        elif kind == 1 and isinstance(parent, dict):
            renamed = _removed(document, path)
            at(renamed, path[:-1])[f"{path[-1]}_"] = at(document, path)
            yield f"{name} is renamed", renamed
        elif kind == 1 or (kind == 2 and isinstance(parent, list)):
            changed = copy.deepcopy(document)
            rows = at(changed, path[:-1])
            times = int(rng.choice([1, 1, 3, 1000]))
            rows.extend(copy.deepcopy([rows[path[-1]]] * times))
            yield f"{name} is repeated {times} times", changed
        elif kind == 2:
            changed = copy.deepcopy(document)
            at(changed, path[:-1])["extra"] = VALUES[rng.integers(15)]
            yield f"an extra key beside {name}", changed
        elif kind == 3 and isinstance(parent, list) and len(parent) > 1:
            changed = copy.deepcopy(document)
            rng.shuffle(at(changed, path[:-1]))
            yield f"{show_path(path[:-1])} is shuffled", changed
        else:
            other = paths[rng.integers(len(paths))]
            changed = replaced(document, path, copy.deepcopy(at(document, other)))
            yield f"{name} holds {show_path(other)}", changed


def texts(rng: np.random.Generator, data: bytes, number: int) -> Iterator[tuple[str, bytes]]:
    """``number`` texts that are no JSON any more, or JSON of another kind."""
    fixed = [
        ("empty", b""),
        ("white space", b" \n"),
        ("byte order mark", b"\xef\xbb\xbf" + data),
        ("UTF-16", data.decode().encode("utf-16")),
        ("twice", data + data),
        ("a list around it", b"[" + data + b"]"),
        ("a comma at the end", data.rstrip()[:-1] + b",}"),
        ("a list of 200,000 levels", b"[" * 200_000),
        ("an object of 100,000 levels", b'{"a":' * 100_000),
        ("levels that are closed", b"[" * 5000 + b"]" * 5000),
        ("a number", b"17"),
        ("null", b"null"),
        ("a key twice", data.rstrip()[:-1] + b"," + data.strip()[1:]),
        ("no UTF-8", data.replace(b'"', b'"\xff', 1)),
        ("a null byte", data[:40] + b"\0" + data[40:]),
        ("5 MB of spaces", data + b" " * 5_000_000),
    ]
    yield from fixed[:number]
    yield from damage_bytes.anywhere(rng, data, max(number - len(fixed), 0))


def documents(rng: np.random.Generator, document: Any, number: int) -> Iterator[tuple[str, bytes]]:
    """``number`` damaged texts of a document: three quarters values, the rest structure and text."""
    few = number // 8
    for text, changed in values(rng, document, number - 2 * few):
        yield text, dump(changed)
    for text, changed in structures(rng, document, few):
        yield text, dump(changed)
    yield from texts(rng, dump(document), few)
