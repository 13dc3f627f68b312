"""Models in folders: writing, reading, and the one that ships with the package.

A model folder holds ``model.json`` (the index: configs and statistics), safetensors files with the parameters, and the
token features of prompts that need no text encoder.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from scjax.diffusion.defaults import DEFAULT_TEMPERATURE
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.generate.components import COMPONENTS, Component, Model
from scjax.generate.model_checks import check_model
from scjax.generate.model_format import (
    FORMAT,
    ModelIndex,
    codec_from_json,
    config_to_json,
    index_hash,
    read_config,
    read_part,
    upgrade,
)
from scjax.generate.outlines import Outlines
from scjax.generate.prompt_cache import load_prompts, write_prompts
from scjax.generate.view_outlines import ViewOutlines
from scjax.models.latents import LatentStatistics
from scjax.nn.safetensors import array_names, named_arrays, read_arrays, sha256_of, write_arrays
from scjax.scene.document import convert_document, parse_document
from scjax.scene.files import whole_folder

DEFAULT_MODEL = Path(__file__).parents[1] / "pretrained"
"""Folder of the model that ships with the package."""

INDEX, PROMPTS = "model.json", "prompts.safetensors"
_CURE = "copy or export the model again"
_ATTEMPTS = 20
_WEIGHTS = "weights.safetensors"
_OUTLINES, _VIEWS = "outlines.", "views."  # begin the names of their arrays


def save_model(model: Model, folder: str | Path, *, dtype: str | None = None, largest: float | None = None) -> Path:
    """Writes a model folder and returns its path. An existing folder is replaced at the end, as a whole.

    Args:
      dtype, largest: precision and size [MB] of the weight files, as in ``scjax.nn.safetensors.write_arrays``.

    Raises:
      ValueError: a part of the model is not sound (``check_model``); nothing is written.
      OSError: the folder cannot be written; names it.
    """
    folder = Path(folder)
    try:
        check_model(model)
    except ValueError as error:
        raise ValueError(f"the model is not saved as {folder}: {error}") from error
    index = {
        "format": FORMAT,
        "components": {name: config_to_json(component.config) for name, component in model.components.items()},
        "codec": dataclasses.asdict(model.codec),
        "latents": dataclasses.asdict(model.latents),
        "domains": list(model.domains),
        "text_encoder": model.text_encoder,
        "image_encoder": model.image_encoder,
        "image_keeps_aspect": model.image_keeps_aspect,
        "estimates_depth": model.estimates_depth,
        "reads_prompts": model.reads_prompts,
        "temperature": dataclasses.asdict(model.temperature),
        "num_steps": model.num_steps,
        "guidance": model.guidance,
        "energy_guidance": dataclasses.asdict(model.energy_guidance) if model.energy_guidance else None,
        "notes": model.notes,
    }
    params = {name: component.params for name, component in model.components.items()}
    arrays = array_names(params)
    tables = {} if model.counts is None else {"counts": np.asarray(model.counts)}
    if model.outlines is not None:
        tables |= {f"{_OUTLINES}{name}": array for name, array in model.outlines.arrays().items()}
        index["outline_values"] = dict(model.outlines.values)
    if model.views is not None:
        tables |= {f"{_VIEWS}{name}": array for name, array in model.views.arrays().items()}
    arrays |= tables
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is a file: choose another folder for the model")
    with whole_folder(folder, "the model") as temporary:
        index["files"] = write_arrays(arrays, temporary, dtype=dtype, largest=largest, exact=tables)
        if model.prompts:
            write_prompts(model.prompts, model.text_encoder, temporary / PROMPTS)
            index["prompts"] = sha256_of(temporary / PROMPTS)
        index["checked"] = index_hash(index)
        (temporary / INDEX).write_text(json.dumps(index, indent=1, allow_nan=False))
    return folder


def load_model(path: str | Path | None = None) -> Model:
    """Reads a model folder that ``save_model``, training or ``python -m scjax.convert`` wrote.

    Args:
      path: the folder; None: the model that ships with scjax, trained on its synthetic world alone, read once.

    Raises:
      ValueError: the folder is missing, incomplete, damaged (by the hashes of its files), or of a newer format.
    """
    return _default_model() if path is None else _read(Path(path))


@functools.cache
def _default_model() -> Model:
    return _read(DEFAULT_MODEL)


def _read(folder: Path) -> Model:
    """Reads a folder; once more where another process replaces it meanwhile."""
    for _ in range(_ATTEMPTS):
        before = _identity(folder)
        try:
            return _read_once(folder)
        except ValueError:
            if before == _identity(folder) and (before or not list(folder.parent.glob(f".{folder.name}.*.part"))):
                raise
            time.sleep(0.05)
    return _read_once(folder)


def _identity(folder: Path) -> tuple[int, int] | None:
    try:
        status = folder.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _read_once(folder: Path) -> Model:
    path = folder / INDEX
    if not path.is_file():
        raise ValueError(f"{folder} is no model folder: it has no {INDEX}. Train one with python -m experiments.train")
    try:
        content = parse_document(path.read_bytes(), dict[str, Any], path, _CURE)
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}): {_CURE}") from error
    version = content.get("format", 0)
    if not isinstance(version, int) or not 0 <= version <= FORMAT:
        raise ValueError(f"{folder} has model format {version!r:.80}, this code reads {FORMAT}: update scjax")
    is_checked = content.get("checked") == index_hash(content)
    files = convert_document(content.get("files", {_WEIGHTS: ""}), dict[str, str], f"{path}: files", _CURE)
    arrays = read_arrays(folder, files)
    try:
        index, arrays = upgrade(content, arrays)
        model = _model_of(index, arrays, folder)
        if not is_checked:
            check_model(model)
    except ValueError as error:
        raise ValueError(f"{path}: {error}: {_CURE}") from error
    return model


def _views_of(arrays: dict[str, np.ndarray], components: dict[str, Component]) -> ViewOutlines:
    if "denoiser" not in components:
        raise ValueError("there are view outlines, but no denoiser that reads them")
    config = components["denoiser"].config
    return ViewOutlines.from_files(arrays, (config.lane_kinds, config.agent_kinds))


def _model_of(content: dict[str, Any], arrays: dict[str, np.ndarray], folder: Path) -> Model:
    index = convert_document(content, ModelIndex, "the index", "")
    counts = arrays.pop("counts", None)
    parts, views = (
        {name.removeprefix(start): arrays.pop(name) for name in list(arrays) if name.startswith(start)}
        for start in (_OUTLINES, _VIEWS)
    )
    params = named_arrays(arrays)
    components = {}
    for name, fields in index.components.items():
        if name not in COMPONENTS:
            raise ValueError(f"components has no {name[:60]!r}: choose from {', '.join(COMPONENTS)}")
        if name not in params:
            raise ValueError(f"there are no arrays of the {name}")
        components[name] = Component(read_config(name, COMPONENTS[name].config, fields), params[name])
    guidance = index.energy_guidance
    return Model(
        components=components,
        codec=read_part("codec", codec_from_json, index.codec),
        latents=LatentStatistics(mean=index.latents.mean.to_per_type(), std=index.latents.std.to_per_type()),
        domains=tuple(index.domains),
        counts=counts,
        outlines=read_part("outlines", lambda values: Outlines.from_files(parts, values), index.outline_values)
        if parts
        else None,
        views=_views_of(views, components) if views else None,
        text_encoder=index.text_encoder,
        image_encoder=index.image_encoder,
        image_keeps_aspect=index.image_keeps_aspect,
        estimates_depth=index.estimates_depth,
        reads_prompts=index.reads_prompts,
        prompts=load_prompts(folder / PROMPTS, index.text_encoder, index.prompts),
        temperature=index.temperature.to_per_type() if index.temperature else DEFAULT_TEMPERATURE,
        num_steps=index.num_steps,
        guidance=index.guidance,
        energy_guidance=read_part("energy_guidance", EnergyGuidance.from_dict, guidance) if guidance else None,
        notes=index.notes,
    )
