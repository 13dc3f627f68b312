"""Checkpoints of the official release, and model folders."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import damage_bytes, damage_json, names
from benchmarks.robustness.areas_encoders import folder_writer, weight_damage
from benchmarks.robustness.case import SOUND, Case, Refused
from benchmarks.robustness.fixtures import HEADS, PROMPT
from benchmarks.robustness.invariants import arrays_fault, scene_fault

FOLDER = "my-model"
COUNTS = {"num_lanes": 3, "num_agents": 2}


def official(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """State dicts of the official release through ``python -m scjax.convert official``."""
    for name, heads in HEADS.items():
        path = fixtures / f"official/{name}.safetensors"
        if not path.exists():
            raise FileNotFoundError(f"{path} is not there: set SCJAX_PARITY_DIR")
        data, file_name = path.read_bytes(), f"{name}.safetensors"

        def read(folder: Path, file_name: str = file_name, heads: tuple[int, int] = heads) -> Any:
            return _convert(folder / file_name, folder / "out", heads)

        for text, changed in (*weight_damage(rng, data, 58), (SOUND, data)):
            yield Case(f"{name}: {text}", read, arrays_fault, (file_name,), _writer(file_name, changed))


def _writer(name: str, data: bytes) -> Any:
    return lambda folder: (folder / name).write_bytes(data) and None


def _convert(path: Path, out: Path, heads: tuple[int, int]) -> Any:
    try:
        names.get("convert")(["official", str(path), str(out), "--heads", str(heads[0]), str(heads[1])])
    except SystemExit as error:
        if isinstance(error.code, str):
            return Refused(error.code, 1)
        if error.code:
            return Refused("", int(error.code))
    return names.get("load_model")(out)


def models(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Model folders: they are loaded, and two steps are sampled from those that load."""
    for text, kind, changes in _model_damage(rng, fixtures):
        prompt = PROMPT if kind == "text" else None
        write = folder_writer(fixtures / kind, FOLDER, changes)
        arguments = (
            FOLDER,
            *changes,
            *damage_json.field_names(text),
            *(["text encoder"] if "prompts" in text else ["a prompt is given"]),
        )
        yield Case(
            f"{kind}, {text}",
            lambda folder, prompt=prompt: _load_and_sample(folder, prompt),
            _model_fault,
            arguments,
            write,
        )


def _load_and_sample(folder: Path, prompt: str | None) -> Any:
    import jax

    model = names.get("load_model")(folder / FOLDER)
    condition = names.get("Condition")(**COUNTS, **({"prompt": prompt} if prompt else {}))
    arguments = names.sample_arguments({"num_steps": 2})
    return model, names.get("sample")(jax.random.key(0), condition, model=model, **arguments)


def _model_fault(result: Any) -> str | None:
    model, scenes = result
    if fault := arrays_fault(model):
        return f"the model holds numbers that are {fault}"
    scenes = scenes.to_numpy()
    if int(scenes.num_lanes[0]) != COUNTS["num_lanes"] or int(scenes.num_agents[0]) != COUNTS["num_agents"]:
        return f"{scenes.num_lanes[0]} lanes and {scenes.num_agents[0]} agents"
    return scene_fault(scenes)


def _model_damage(rng: np.random.Generator, fixtures: Path) -> Iterator[tuple[str, str, dict[str, bytes | None]]]:
    for kind, number in (("plain", 60), ("text", 110)):
        yield SOUND, kind, {}
        index = json.loads((fixtures / kind / "model.json").read_text())
        for text, data in damage_json.documents(rng, index, number):
            yield f"model.json: {text}", kind, {"model.json": data}
    for name in ("model.json", "weights.safetensors", "prompts.safetensors"):
        yield f"{name} is missing", "text", {name: None}
    weights = (fixtures / "text/weights.safetensors").read_bytes()
    for text, data in damage_bytes.anywhere(rng, weights, 20):
        yield f"weights: {text}", "text", {"weights.safetensors": data}
    index = (fixtures / "text/model.json").read_text()
    before = hashlib.sha256(weights).hexdigest()
    for text, data in weight_damage(rng, weights, 30):
        changed = index.replace(before, hashlib.sha256(data).hexdigest()).encode()
        yield f"weights with a fitting hash: {text}", "text", {"weights.safetensors": data, "model.json": changed}
    for text, data in weight_damage(rng, (fixtures / "text/prompts.safetensors").read_bytes(), 50):
        yield f"prompts: {text}", "text", {"prompts.safetensors": data}
