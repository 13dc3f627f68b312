"""Checkpoints of trainings, and configs of trainings."""

from __future__ import annotations

import importlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.robustness import damage_bytes, damage_json, names
from benchmarks.robustness.case import SOUND, Case
from benchmarks.robustness.fixtures import RESOLVED, state_of
from benchmarks.robustness.invariants import arrays_fault

_VALUES: tuple[Any, ...] = (
    None,
    True,
    "word",
    "",
    -1,
    0,
    1,
    1.5,
    3.0,
    10**6,
    10**12,
    float("nan"),
    float("inf"),
    -1e30,
    [],
    {},
    [1.5],
    (1, 2, 3),
    ((0, 0),),
    ((61, 100), (12, 16)),
    ("a", "b"),
    "/nowhere",
)


def checkpoints(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Checkpoint folders with one damaged file; what is restored must be what was saved."""
    import jax

    source, like = fixtures / "checkpoints", state_of(fixtures)
    saved = jax.device_get(like)

    def read(folder: Path) -> Any:
        with names.get("Checkpoints")(folder / "checkpoints", RESOLVED) as opened:
            return None if opened.latest is None else opened.restore(like)

    def check(result: Any) -> str | None:
        if result is None:
            return None  # an unfinished checkpoint is left out, by design
        state, data = result
        if not isinstance(data, dict):
            return f"the position of the data is {data!r}"
        same = jax.tree.map(np.array_equal, jax.device_get(state), saved)
        return None if all(jax.tree.leaves(same)) else "another state than was saved"

    paths = sorted(path.relative_to(source) for path in source.rglob("*") if path.is_file())
    yield _checkpoint_case(SOUND, source, paths[0], (source / paths[0]).read_bytes(), read, check)
    for path in paths:
        yield _checkpoint_case(f"{path} is missing", source, path, None, read, check)
    for k in range(max(140 - len(paths), 0)):
        path = paths[k % len(paths)]
        data = (source / path).read_bytes()
        try:
            document = json.loads(data)
            text, changed = next(damage_json.documents(rng, document, 1))
        except ValueError:
            document = None
        if document is None or rng.integers(2):
            text, changed = next(damage_bytes.anywhere(rng, data, 1))
        yield _checkpoint_case(f"{path}: {text}", source, path, changed, read, check)


def _checkpoint_case(text: str, source: Path, path: Path, data: bytes | None, read: Any, check: Any) -> Case:
    def write(folder: Path) -> None:
        shutil.copytree(source, folder / "checkpoints")
        target = folder / "checkpoints" / path
        if data is None:
            target.unlink()
        else:
            target.write_bytes(data)

    return Case(text, read, check, ("checkpoints", path.name), write)


def configs(rng: np.random.Generator, fixtures: Path) -> Iterator[Case]:
    """Configs of trainings with a wrong value of one field: objective, state and first batch, or a refusal."""
    counts = "counter" if names.is_old() else "counts"
    for objective, number in (("autoencoder", 70), ("denoiser", 70), (counts, 10)):
        fields = [field for field in _leaves(_config(objective, fixtures).to_dict()) if "position_head" not in field]
        pairs = [(field, k) for field in fields for k in range(len(_VALUES))]
        rng.shuffle(pairs)
        yield Case(
            f"{objective}: {SOUND}",
            lambda folder, o=objective: _start_run(o, fixtures, folder, "records", str(fixtures / "records")),
            arrays_fault,
            (),
        )
        for field, k in pairs[:number]:
            value, short = _VALUES[int(k)], str(field).rsplit(".", 1)[-1]
            yield Case(
                f"{objective}: config.{field} = {damage_json.show(value)}",
                lambda folder, o=objective, f=str(field), v=value: _start_run(o, fixtures, folder, f, v),
                arrays_fault,
                (short, str(value) if value == "/nowhere" else short),
            )
        for field in rng.permutation(fields)[:10]:
            yield Case(
                f"{objective}: config.{field} is missing",
                lambda folder, o=objective, f=str(field): _start_run(o, fixtures, folder, f, _MISSING),
                arrays_fault,
                (str(field).rsplit(".", 1)[-1],),
            )


_MISSING = object()


def _config(objective: str, fixtures: Path) -> Any:
    config = names.get("small_config")(objective)
    config.records = str(fixtures / "records")
    for name in ("autoencoder", "denoiser"):
        if name in config:
            setattr(config, name, str(fixtures / ("plain" if name == "autoencoder" else "text")))
    return config


def _leaves(content: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in content.items():
        if isinstance(value, dict) and value:
            if name not in ("cross_attention_options", "control_options"):
                yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"


def _start_run(objective: str, fixtures: Path, folder: Path, field: str, value: Any) -> Any:
    """What a training does before its first step; returns its first batch."""
    config = _config(objective, fixtures).unlock()
    *path, name = field.split(".")
    node = config
    for part in path:
        node = node[part]
    with node.unlocked(), node.ignore_type():
        if value is _MISSING:
            del node[name]
        else:
            node[name] = value
    if names.is_old():
        return _old_run(config, json.loads(config.to_json()))
    try:
        from scjax.train.configs.schema import check_config
    except ImportError:  # commits before this check
        return _new_run(config, json.loads(config.to_json()), folder)
    return _new_run(config, check_config(config), folder)  # as ``scjax.train.loop.train`` begins


def _new_run(config: Any, resolved: dict[str, Any], folder: Path) -> Any:
    from scjax.data.loader import LoaderConfig
    from scjax.train.checkpoint import Checkpoints
    from scjax.train.loop import TrainingRun
    from scjax.train.objectives import make_objective

    objective = make_objective(config)
    batches = names.get("training_batches")(
        config.records,
        objective.codec,
        LoaderConfig.from_json(resolved["batch"]),
        texts=objective.texts,
        images=objective.images,
    )
    with Checkpoints(folder / "checkpoints", resolved) as opened:
        TrainingRun(config, resolved, folder, objective, batches, opened)
    return next(batches).scene


def _old_run(config: Any, resolved: dict[str, Any]) -> Any:
    import jax

    train = importlib.import_module("experiments.train")
    stage = train.STAGES[config.stage].build(config)
    batches = names.get("training_batches")(
        config.records,
        stage.representation,
        train.pipeline_config(resolved["batch"]),
        texts=stage.texts,
        images=stage.images,
    )
    stage.init(jax.random.fold_in(jax.random.key(config.seed), 0))
    return next(batches).scene
