"""The ablation from config to report: a base, then a training and two sets of samples a mechanism, kind and seed."""

from __future__ import annotations

import json
import shutil
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from ml_collections import ConfigDict
from tqdm import tqdm

import scjax
from experiments.studies.ablation.denoising import denoising_losses
from experiments.studies.ablation.entries import ENTRIES, PADDED_SLOTS, Entry, chosen
from experiments.studies.ablation.judge import Sampler, sampled, values_of
from experiments.studies.ablation.report import write
from experiments.studies.ablation.requests import Requests, padded, requests_of
from scjax.evaluate.generated import weights_hash
from scjax.evaluate.hashing import content_hash
from scjax.metrics.measure import measure
from scjax.models.flops import denoiser_forward
from scjax.scene.files import write_text
from scjax.train.loop import train

FORMAT = 3  # of a run's result; to be raised when what it holds changes
CROPS = {"text": (1.0, 0.0, 0.0), "image": (0.0, 0.0, 1.0)}  # captions describe centred windows, images forward ones


def ablate(config: Any, workdir: Path) -> Path | None:
    """The whole ablation, top to bottom; the report, or None if a signal stopped it.

    Raises:
      ValueError: from the config; nothing is trained then.
    """
    workdir.mkdir(parents=True, exist_ok=True)
    (workdir / "config.json").write_text(json.dumps(json.loads(config.to_json()), indent=1))
    names = {kind: chosen(tuple(config.entries), kind) for kind in config.kinds}
    frozen = scjax.load(config.autoencoder)
    sampler = Sampler(config.sampler, config.sampler_steps, float(config.guidance))
    largest = tuple(max(bucket) for bucket in zip(*config.training.batch.buckets, strict=True))
    asked = {kind: requests_of(kind, config.records, config.samples, frozen, largest) for kind in names}

    # A whole seed at a time: a report of what is done so far compares everything.
    todo = [(seed, kind, name) for seed in config.seeds for kind in names for name in names[kind]]
    if not todo:
        raise ValueError("config.kinds, config.entries and config.seeds name no run: give at least one of each")
    setting = _setting(config, {kind: requests.fingerprint for kind, requests in asked.items()})
    rows = [run for path in config.more for run in runs_of(path, setting, todo)]  # before a base is trained
    base = config.base or _base(config, workdir)
    if base is None:
        return None
    known = weights_hash(scjax.load(base))
    check_bases([*rows, *({"seed": seed, "kind": kind, "base": known} for seed, kind, _ in todo)])
    with tqdm(todo, unit="run", disable=None) as bar:
        for seed, kind, name in bar:
            bar.set_description(f"{kind} {name} {seed}")
            row = _row(config, workdir, base, known, asked[kind], name, kind, seed, sampler)
            if row is None:
                return None
            rows.append({"kind": kind, "entry": name, "seed": seed, "base": known, **row})
            report = write(rows, workdir, setting)
            jax.clear_caches()  # the programs of a mechanism are of no use to another
    return report


def _setting(config: Any, asked: dict[str, str]) -> dict[str, Any]:
    """All that runs of several seeds, perhaps made on several machines, have in common."""
    fields = json.loads(config.to_json())
    for name in ("records", "autoencoder", "base", "seeds", "entries", "kinds", "more"):
        fields.pop(name)
    return {"format": FORMAT, "asked": asked, **fields}


def runs_of(path: str, setting: Mapping[str, Any], todo: Sequence[tuple[int, str, str]]) -> list[dict[str, Any]]:
    """The runs of other seeds or kinds, from the ablation.json that another work folder has.

    Raises:
      ValueError: no such file, another setting, or a run that is to be made here as well (seed, kind, entry).
    """
    try:
        content = json.loads(Path(path).read_text())
        told, runs = content["setting"], content["runs"]
    except (OSError, ValueError, KeyError) as error:
        raise ValueError(f"config.more: {path} is no ablation.json ({error!r})") from None
    # What is asked of a kind matters only if both have it.
    both = told["asked"].keys() & setting["asked"].keys()
    one, other = ({**side, "asked": {kind: side["asked"][kind] for kind in both}} for side in (told, setting))
    if differing := sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name)):
        raise ValueError(f"config.more: {path} was made with another {', '.join(differing)}: its runs do not compare")
    if twice := sorted({(run["seed"], run["kind"], run["entry"]) for run in runs} & set(todo)):
        seed, kind, entry = twice[0]
        raise ValueError(f"config.more: {path} has {entry} on {kind} of seed {seed}, which is to be run here as well")
    return runs


def check_bases(runs: Sequence[Mapping[str, Any]]) -> None:
    """Gains are taken within a seed and kind; machines round differently, so that another one's base is another base.

    Raises:
      ValueError: a seed whose runs on one kind started from two.
    """
    bases: dict[tuple[int, str], str] = {}
    for run in runs:
        seed, kind = run["seed"], run["kind"]
        if bases.setdefault((seed, kind), run["base"]) != run["base"]:
            raise ValueError(
                f"config.more: seed {seed} on {kind}s would have runs from two bases, which do not compare: "
                "give the base of those made elsewhere by config.base, or make all of them here"
            )


def _base(config: Any, workdir: Path) -> str | None:
    """Model folder of the unconditional denoiser that these runs start from, trained on all of their windows."""
    training = _copy(config)
    training.seed = training.batch.seed = config.seeds[0]
    training.steps = config.base_steps
    training.optimizer.warmup = min(training.optimizer.warmup, max(config.base_steps // 5, 1))
    training.batch.crops = tuple(sum(np.array([CROPS[kind] for kind in config.kinds])).tolist())
    training.condition = "none"
    return _trained(training, workdir / f"base-{content_hash(training.to_json())[:8]}")


def run_config(config: Any, base: str, entry: Entry, kind: str, seed: int) -> ConfigDict:
    """What ``experiments.train`` does for one run; between mechanisms only the mechanism differs."""
    training = _copy(config)
    training.init_from, training.condition, training.cross_attention = base, kind, entry.cross_attention
    training.seed = training.batch.seed = seed
    training.batch.crops = CROPS[kind]
    options = entry.options_of(kind)
    if options:
        training.cross_attention_options[entry.cross_attention].update(options)
    training.model.attend_padding = entry.padded
    if entry.padded and kind == "text":
        training.batch.text_slots = PADDED_SLOTS
    training.update_from_flattened_dict(entry.training)
    return training


def _copy(config: Any) -> ConfigDict:
    training = ConfigDict(config.training.to_dict())
    training.records, training.autoencoder = config.records, config.autoencoder
    return training


def _row(
    config: Any,
    workdir: Path,
    base: str,
    known: str,
    requests: Requests,
    name: str,
    kind: str,
    seed: int,
    sampler: Sampler,
) -> dict[str, Any] | None:
    """A run's result, made now or before; None if a signal stopped it."""
    training = run_config(config, base, ENTRIES[name], kind, seed)
    told = content_hash(json.dumps({**json.loads(training.to_json()), "init_from": known}, sort_keys=True))[:8]
    folder = workdir / "runs" / f"{kind}-{name}-{seed}-{told}"
    path = folder / f"result-{content_hash(str(FORMAT), requests.fingerprint, str(sampler))[:8]}.json"
    if path.exists():
        return json.loads(path.read_text())
    trained = _trained(training, folder)
    if trained is None:
        return None
    made = _result(scjax.load(trained), folder, path.stem, base, requests, ENTRIES[name], kind, seed, sampler)
    write_text(path, json.dumps(made, indent=1))
    return made


def _trained(training: ConfigDict, folder: Path) -> str | None:
    """The folder's model, trained or trained on; None if a signal stopped the training."""
    model = folder / "model"
    if not model.exists():
        train(training, folder)
    if not model.exists():
        return None
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)  # ten times the model, and there are many
    return str(model)


def _result(
    model: scjax.Model,
    folder: Path,
    stem: str,
    base: str,
    requests: Requests,
    entry: Entry,
    kind: str,
    seed: int,
    sampler: Sampler,
) -> dict[str, Any]:
    slots = PADDED_SLOTS if entry.padded and kind == "text" else 0
    real = measure(requests.references, requests.clusters)
    found: dict[str, Any] = {}
    for which, conditions in (("own", requests.own), ("shuffled", requests.shuffled)):
        if which == "shuffled" and entry.cross_attention == "none":
            found["shuffled"] = found["own"]  # nobody reads it
            continue
        told, path = padded(conditions, slots), folder / f"{stem}-{which}.npz"
        scenes, seconds = sampled(model, told, sampler, seed, path)
        loss = denoising_losses(model, requests.references, told, seed).mean()
        found[which] = values_of(scenes, requests, real, float(loss))
        found["seconds_a_scene"] = seconds
    lanes, agents = (
        float(np.mean([getattr(scene, name) for scene in requests.references])) for name in ("num_lanes", "num_agents")
    )
    context, config = slots or requests.context, model.denoiser.config
    flops = {
        f"flops{name}": denoiser_forward(config, lanes, agents, context, cached=cached)  # pyright: ignore
        for name, cached in (("", False), ("_cached", True))
    }
    return {
        **found,
        **flops,
        "parameters": _size(model) - _size(scjax.load(base)),
        "seconds_a_step": _step_seconds(folder),
    }


def _size(model: scjax.Model) -> int:
    return sum(np.size(leaf) for leaf in jax.tree.leaves(model.denoiser.params))


def _step_seconds(folder: Path) -> float:
    """The median over what was logged: compilation and interruptions fall into few of the lines."""
    lines: Sequence[dict[str, Any]] = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    size = json.loads((folder / "config.json").read_text())["batch"]["batch_size"]
    return statistics.median(size / line["scenes_per_second"] for line in lines if line["scope"] == "train")
