"""Damaged model folders: a sound model, or a ValueError that names the folder; and loading beside saving."""

from __future__ import annotations

import copy
import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.generate.model import load_model, save_model
from scjax.generate.model_checks import check_model
from scjax.models.denoiser.config import TextCondition
from tests.factories.words import Words
from tests.factories.worlds import tiny_model

VALUES: list[Any] = [None, True, "", "x", [], {}, -1, 0, 3, 1.5, 1e30, float("nan"), [[1]], {"a": 1}]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    model = dataclasses.replace(
        tiny_model(TextCondition(Words.width)), text_encoder=Words.name, prompts={"a road": Words.features("a road")}
    )
    return save_model(model, tmp_path_factory.mktemp("damage") / "model")


def _paths(node: Any, path: tuple = ()) -> list[tuple]:
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [found for key, value in items for found in ((*path, key), *_paths(value, (*path, key)))]


@given(data=st.data(), value=st.sampled_from(VALUES), removed=st.booleans())
@settings(max_examples=60, deadline=None)
def test_damaged_index_is_sound_or_named(data, value, removed, folder, tmp_path_factory):
    index = json.loads((folder / "model.json").read_text())
    path = data.draw(st.sampled_from([path for path in _paths(index) if path[0] not in ("notes", "checked")]))
    changed = copy.deepcopy(index)
    parent: Any = changed
    for key in path[:-1]:
        parent = parent[key]
    if removed:
        del parent[path[-1]]
    else:
        parent[path[-1]] = value
    other = tmp_path_factory.mktemp("index") / "model"
    other.mkdir()
    for file in folder.iterdir():
        (other / file.name).write_bytes(file.read_bytes())
    (other / "model.json").write_text(json.dumps(changed))
    try:
        check_model(load_model(other))
    except ValueError as error:
        assert str(other) in str(error)


@pytest.mark.parametrize("name", ["weights.safetensors", "prompts.safetensors", "model.json"])
@pytest.mark.parametrize("damage", ["flip", "cut", "gone", "empty"])
def test_damaged_files_are_named(name, damage, folder, tmp_path):
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    content = bytearray((tmp_path / name).read_bytes())
    if damage == "gone":
        (tmp_path / name).unlink()
    else:
        content[len(content) // 2] ^= 255
        (tmp_path / name).write_bytes({"flip": content, "cut": content[:40], "empty": b""}[damage])
    with pytest.raises(ValueError, match=tmp_path.name):
        load_model(tmp_path)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_models_with_nan_are_not_saved(value, tmp_path):
    model = tiny_model()
    params = copy.deepcopy(model.autoencoder.params)
    leaf = params["encoder"]
    while isinstance(leaf, dict):
        parent, key = leaf, sorted(leaf, key=str)[0]
        leaf = leaf[key]
    parent[key] = np.full_like(leaf, value)
    with pytest.raises(ValueError, match=r"is not saved as .*: the array autoencoder\.encoder\..* holds NaN"):
        save_model(model.with_component("autoencoder", model.autoencoder.config, params), tmp_path / "model")
    assert not list(tmp_path.iterdir())


def test_parts_of_different_models_are_refused(tmp_path):
    model = dataclasses.replace(tiny_model(), domains=("here",), counts=None)
    with pytest.raises(ValueError, match=r"denoiser\.domains is 2, but the number of domains is 1"):
        save_model(model, tmp_path / "model")


def test_load_beside_save_never_fails(tmp_path):
    save_model(tiny_model(), tmp_path / "model")
    code = "import sys; from scjax.generate.model import load_model, save_model\n"
    code += "model = load_model(sys.argv[1])\nprint('ready', flush=True)\nwhile True: save_model(model, sys.argv[1])"
    root = Path(__file__).resolve().parents[2]
    command = [sys.executable, "-c", code, str(tmp_path / "model")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=root, text=True) as writer:
        try:
            assert writer.stdout is not None and writer.stdout.readline() == "ready\n"
            for _ in range(40):
                load_model(tmp_path / "model")
        finally:
            writer.kill()
    save_model(tiny_model(), tmp_path / "model")
    assert [path.name for path in tmp_path.iterdir()] == ["model"]
