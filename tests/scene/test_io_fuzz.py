"""Damaged scene and log files: a valid scene, or a ValueError that names the file; nothing else."""

from __future__ import annotations

import copy
import io
import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.scene import io as scene_io
from scjax.scene import load_log, save_log, validate
from tests.factories.examples import example_scene
from tests.factories.logs import example_log

VALUES: list[Any] = [
    None,
    True,
    "",
    "x",
    [],
    [[]],
    {},
    -1,
    0,
    7,
    1.5,
    1e30,
    -1e308,
    10**400,
    float("nan"),
    float("inf"),
]
DOCUMENT = json.loads(scene_io.scene_to_json(example_scene(agents=3, lanes=3)))


def _paths(node: Any, path: tuple = ()) -> list[tuple]:
    """Paths of all fields and items of a document."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [found for key, value in items for found in ((*path, key), *_paths(value, (*path, key)))]


PATHS = _paths(DOCUMENT)


def _parent(document: Any, path: tuple) -> Any:
    for key in path[:-1]:
        document = document[key]
    return document


@given(path=st.sampled_from(PATHS), value=st.sampled_from(VALUES), action=st.sampled_from(["set", "remove", "repeat"]))
@settings(max_examples=200, deadline=None)
def test_damaged_json_is_read_or_named(path, value, action):
    document = copy.deepcopy(DOCUMENT)
    parent = _parent(document, path)
    if action == "set":
        parent[path[-1]] = value
    elif action == "remove":
        del parent[path[-1]]
    elif isinstance(parent, list):
        parent.append(copy.deepcopy(parent[path[-1]]))
    try:
        validate(scene_io.scene_from_json(json.dumps(document), name="mine.json"))
    except ValueError as error:
        assert str(error).startswith("mine.json")


@given(cut=st.integers(0, 3000), junk=st.binary(max_size=20))
@settings(max_examples=50, deadline=None)
def test_cut_json_is_named(cut, junk, tmp_path_factory):
    path = tmp_path_factory.mktemp("cut") / "mine.json"
    path.write_bytes(json.dumps(DOCUMENT).encode()[:cut] + junk)
    with pytest.raises(ValueError, match=r"mine\.json"):
        scene_io.load_json(path)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored")
    scene_io.save_npz(example_scene(agents=3, lanes=3), folder / "scene.npz")
    save_log(example_log(), folder / "log.npz")
    return folder


@pytest.mark.parametrize("name", ["scene.npz", "log.npz"])
@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_damaged_npz_is_read_or_named(name, data, stored):
    content = bytearray((stored / name).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = stored / f"damaged-{name}"
    path.write_bytes(content[: data.draw(st.sampled_from([len(content), len(content) // 2]))])
    try:
        loaded = load_log(path) if name == "log.npz" else scene_io.load_npz(path)
    except ValueError as error:
        assert f"damaged-{name}" in str(error)
    else:
        assert loaded is not None


@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_npz_of_other_arrays_is_valid_or_named(data, tmp_path_factory):
    arrays: dict[str, Any] = {"format_version": np.int64(1), **example_scene(agents=3, lanes=3).to_dict()}
    name = data.draw(st.sampled_from(sorted(arrays)))
    array = np.array(arrays[name])
    change = data.draw(st.sampled_from(["type", "shape", "value", "gone"]))
    if change == "type":
        array = array.astype(data.draw(st.sampled_from(["f8", "i8", "u1", "?", "U3", "c16", "S2"])))
    elif change == "shape":
        array = array[..., None] if data.draw(st.booleans()) else array.reshape(-1)[:1]
    elif array.size and change == "value":
        flat = array.reshape(-1)
        with np.errstate(all="ignore"):
            flat[data.draw(st.integers(0, flat.size - 1))] = data.draw(st.sampled_from([0, 1, 120, 5]))
    arrays[name] = array
    if change == "gone":
        del arrays[name]
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    path = tmp_path_factory.mktemp("npz") / "mine.npz"
    path.write_bytes(buffer.getvalue())
    try:
        validate(scene_io.load_npz(path))
    except ValueError as error:
        assert "mine.npz" in str(error)
