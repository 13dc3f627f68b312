"""Sampling with tiny models, and what must hold of its results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import names
from benchmarks.robustness.fixtures import PROMPT
from benchmarks.robustness.invariants import scene_fault

COUNTS = {"num_lanes": 3, "num_agents": 2}
"""Of every request that does not say otherwise."""

_models: dict[str, Any] = {}


def sample_tiny(fixtures: Path, kind: str, fields: dict[str, Any], arguments: dict[str, Any]) -> Any:
    """Samples two steps of the fixture ``kind`` with these fields of the condition and these arguments."""
    import jax

    if kind not in _models:
        _models[kind] = names.get("load_model")(fixtures / kind)
    given = {**COUNTS, **fields}
    if kind == "text" and not {"prompt", "streams", "tokens", "negative_tokens"} & set(fields):
        given["prompt"] = PROMPT
    keywords = {"model": _models[kind], "num_steps": 2, **arguments}
    key = keywords.pop("key", jax.random.key(0))
    condition = keywords.pop("condition") if "condition" in keywords else _condition(given)
    return names.get("sample")(key, condition, **names.sample_arguments(keywords))


def _condition(fields: dict[str, Any]) -> Any:
    return names.get("Condition")(**names.condition_fields(fields))


def result_fault(scenes: Any, fields: dict[str, Any], arguments: dict[str, Any]) -> str | None:
    """What is wrong with sampled scenes, for the request that they were sampled for; None if nothing is."""
    if isinstance(scenes, list):
        return next((fault for scene in scenes if (fault := scene_fault(scene.to_numpy()))), None)
    scenes = scenes.to_numpy()
    if fault := scene_fault(scenes):
        return fault
    if "condition" in arguments:
        return None
    if len(scenes.agent_mask) != int(arguments.get("num_scenes", 1)):
        return f"{len(scenes.agent_mask)} scenes for {arguments['num_scenes']!r}"
    for name in COUNTS:
        given, counts = fields.get(name, COUNTS[name]), getattr(scenes, name)
        if given is not None and not (counts == int(given)).all():
            return f"{name} is {counts[0]}, not {given!r}"
    for name, largest in (("temperature", 1e6), ("guidance", 1e6)):
        value = arguments.get(name)
        if isinstance(value, int | float) and abs(value) > largest:
            return f"{name} of {value} is accepted"
    known = fields.get("known")
    if known is not None and hasattr(known, "agents"):
        rows = np.asarray(known.agents)[np.asarray(known.agent_mask)]
        if not np.array_equal(scenes.agents[0, : len(rows)], rows.astype(np.float32)):
            return "known agents are not kept"
    return None
