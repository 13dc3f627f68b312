"""What a run may change when it continues: only what does not shape its remaining steps."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scjax.data.captions import captions_path
from scjax.generate.model import Model
from scjax.nn.functional import Params, flatten

FREE = frozenset(
    {
        "steps",  # may grow, see ``compare_runs``
        "log_every",
        "evaluate_every",
        "picture_every",
        "checkpoint_every",
        "export_at",
        "tensorboard",
        "batch.workers",
    }
)
"""Fields of a config that may change."""

FOLDERS = frozenset({"records", "autoencoder", "denoiser", "init_from", "logs", "cache"})
"""Fields that name a folder, whose content is compared instead."""


def params_hash(params: Params) -> str:
    """SHA-256 of a tree of parameters: paths, types, shapes and values."""
    digest = hashlib.sha256()
    for path, leaf in sorted(flatten(params).items(), key=lambda item: str(item[0])):
        array = np.ascontiguousarray(leaf)
        digest.update(f"{path}{array.dtype}{array.shape}".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()


def model_hash(model: Model, *names: str, **facts: Any) -> str:
    """SHA-256 of some networks of a model, with its codec and latent statistics.

    Args:
      names: of the networks.
      facts: more of the model that a run reads, as JSON values.
    """
    parts = [dataclasses.asdict(model.codec), dataclasses.asdict(model.latents), facts]
    parts += [[name, params_hash(model.components[name].params)] for name in names]
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()


def captions_hash(folder: str | Path, encoder: str) -> str:
    """SHA-256 of the training captions of a record folder and of the name of their encoder."""
    return hashlib.sha256(captions_path(Path(folder), "train").read_bytes() + encoder.encode()).hexdigest()


def compare_runs(
    saved: Mapping[str, Any],
    saved_inputs: Mapping[str, str] | None,
    config: Mapping[str, Any],
    inputs: Mapping[str, str],
) -> list[str]:
    """What differs between the run of a checkpoint and a command that would continue it, field by field.

    Args:
      saved, config: resolved configs.
      saved_inputs, inputs: name of an input -> hash of its content; None: the checkpoint is older than these hashes.
    """
    before, now = (_leaves(_relevant(fields)) for fields in (saved, config))
    differences = [
        f"config.{name} is {_shown(before, name)} there and {_shown(now, name)} here"
        for name in sorted({*before, *now})
        if name not in FREE | FOLDERS and before.get(name) != now.get(name)
    ]
    if config.get("steps", 0) < saved.get("steps", 0):
        differences.append(f"config.steps is {saved['steps']} there and {config['steps']} here, which is less")
    if saved_inputs is not None:
        differences += [
            f"the content of config.{name} is {_short(saved_inputs.get(name))} there, {_short(inputs.get(name))} here"
            for name in sorted({*saved_inputs, *inputs})
            if saved_inputs.get(name) != inputs.get(name)
        ]
    return differences


def _relevant(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The fields, with the options of the chosen conditioning mechanism only."""
    options = fields.get("cross_attention_options")
    if not isinstance(options, Mapping):
        return dict(fields)
    name = fields.get("cross_attention")
    return {**fields, "cross_attention_options": {name: options[name]} if name in options else {}}


def _leaves(fields: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted name -> value."""
    leaves = {}
    for name, value in fields.items():
        if isinstance(value, Mapping):
            leaves |= _leaves(value, f"{prefix}{name}.")
        else:
            leaves[prefix + name] = value
    return leaves


def _shown(leaves: Mapping[str, Any], name: str) -> str:
    text = json.dumps(leaves[name]) if name in leaves else "missing"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _short(digest: Any) -> str:
    return str(digest)[:8] if digest else "none"  # a damaged checkpoint may hold any value
