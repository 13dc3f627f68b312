"""The ablation from config to report: a base, then for each mechanism, modality and seed a training and samples."""

from __future__ import annotations

import dataclasses
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
from experiments.studies.ablation.entries import ENTRIES, PADDED_SLOTS, Entry, select_entries
from experiments.studies.ablation.fixed_scenes import FixedScenesObjective
from experiments.studies.ablation.judge import SamplerSettings, measure_run, sample_to_file
from experiments.studies.ablation.report import write_report
from experiments.studies.ablation.requests import Requests, make_requests, pad_texts
from scjax.evaluate.generated import weights_hash
from scjax.evaluate.hashing import content_hash
from scjax.metrics.measure import measure
from scjax.models.flops import denoiser_forward
from scjax.scene.files import write_text
from scjax.train.loop import train

FORMAT = 4  # of a run's result; raise it when its content changes
CROPS = {"text": (1.0, 0.0, 0.0), "image": (0.0, 0.0, 1.0)}  # captions describe centered crops, images forward crops


def ablate(config: Any, workdir: Path, command: str = "") -> Path | None:
    """The whole ablation; the path of the report, or None if a signal stopped it.

    Args:
      config: of ``experiments.studies.ablation.config``.
      workdir: folder for trainings, samples and, unless ``config.out`` says otherwise, the report.
      command: the command line, for the report.

    Raises:
      ValueError: the config is inconsistent; nothing is trained then.
    """
    workdir.mkdir(parents=True, exist_ok=True)
    (workdir / "config.json").write_text(json.dumps(json.loads(config.to_json()), indent=1))
    names = {modality: select_entries(tuple(config.entries), modality) for modality in config.modalities}
    autoencoder = scjax.load(config.autoencoder)
    settings = SamplerSettings(config.sampler, config.sampler_steps, float(config.guidance))
    agents, lanes = (max(sizes) for sizes in zip(*config.training.batch.buckets, strict=True))
    requests = {
        modality: make_requests(
            modality,
            config.records,
            config.samples,
            autoencoder,
            (agents, lanes),
            config.training.images,
            config.training.image_depth,
        )
        for modality in names
    }

    # Seed by seed, so that a report of the runs so far compares all entries.
    todo = [(seed, modality, name) for seed in config.seeds for modality in names for name in names[modality]]
    if not todo:
        raise ValueError("config.modalities, config.entries and config.seeds name no run: give at least one of each")
    setting = _setting(config, {modality: one.fingerprint for modality, one in requests.items()})
    rows = [run for path in config.more for run in load_runs(path, setting, todo)]  # before a base is trained
    base = config.base or _base(config, workdir)
    if base is None:
        return None
    base_hash = weights_hash(scjax.load(base))
    planned = [{"seed": seed, "modality": modality, "base": base_hash} for seed, modality, _ in todo]
    check_bases([*rows, *planned])
    with tqdm(todo, unit="run", disable=None) as bar:
        for seed, modality, name in bar:
            bar.set_description(f"{modality} {name} {seed}")
            run = _Run(config, workdir, base, base_hash, requests[modality], name, modality, seed, settings)
            row = run.result()
            if row is None:
                return None
            rows.append({"modality": modality, "entry": name, "seed": seed, "base": base_hash, **row})
            out = Path(config.out) if config.out else workdir / "ablation"
            report = write_report(rows, out, setting, command)
            jax.clear_caches()  # another mechanism has other programs
    return report


def _setting(config: Any, fingerprints: dict[str, str]) -> dict[str, Any]:
    """What runs of several seeds, perhaps on several machines, have in common."""
    fields = json.loads(config.to_json())
    for name in ("records", "autoencoder", "base", "seeds", "entries", "modalities", "more", "out"):
        fields.pop(name)
    fields["training"].pop("images")  # a folder; requests have the encoder
    return {"format": FORMAT, "requests": fingerprints, **fields}


def load_runs(path: str, setting: Mapping[str, Any], todo: Sequence[tuple[int, str, str]]) -> list[dict[str, Any]]:
    """Runs of other seeds or modalities, from the ablation.json of another work folder.

    Raises:
      ValueError: no such file, another setting, or a run that is also to be made here (seed, modality, entry).
    """
    try:
        content = json.loads(Path(path).read_text())
        other_setting, runs = content["setting"], content["runs"]
        # Requests of a modality matter only if both have it.
        both = other_setting["requests"].keys() & setting["requests"].keys()
    except (OSError, ValueError, KeyError) as error:
        raise ValueError(f"config.more: {path} is no ablation.json ({error!r})") from None
    one, other = (
        {**side, "requests": {modality: side["requests"][modality] for modality in both}}
        for side in (other_setting, setting)
    )
    if differing := sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name)):
        raise ValueError(f"config.more: {path} was made with another {', '.join(differing)}: its runs do not compare")
    if repeated := sorted({(run["seed"], run["modality"], run["entry"]) for run in runs} & set(todo)):
        seed, modality, entry = repeated[0]
        raise ValueError(f"config.more: {path} has {entry} on {modality} of seed {seed}, which is also to be run here")
    return runs


def check_bases(runs: Sequence[Mapping[str, Any]]) -> None:
    """Runs of one seed and modality must share a base: gains are differences between them.

    Raises:
      ValueError: a seed whose runs on one modality started from two bases.
    """
    bases: dict[tuple[int, str], str] = {}
    for run in runs:
        seed, modality = run["seed"], run["modality"]
        if bases.setdefault((seed, modality), run["base"]) != run["base"]:
            raise ValueError(
                f"config.more: seed {seed} on {modality}s would have runs from two bases, which do not compare: "
                "give the base of those made elsewhere by config.base, or make all of them here"
            )


def _base(config: Any, workdir: Path) -> str | None:
    """Folder of the unconditional denoiser that all runs start from, trained on the crops of all modalities."""
    training = _copy(config)
    training.seed = training.batch.seed = config.seeds[0]
    training.steps = config.base_steps
    training.optimizer.warmup = min(training.optimizer.warmup, max(config.base_steps // 5, 1))
    training.batch.crops = tuple(sum(np.array([CROPS[modality] for modality in config.modalities])).tolist())
    training.condition = "none"
    return _trained(training, workdir / f"base-{content_hash(training.to_json())[:8]}", config.fixed_scenes)


def run_config(config: Any, base: str, entry: Entry, modality: str, seed: int) -> ConfigDict:
    """The training config of one run; between mechanisms only the mechanism differs."""
    training = _copy(config)
    training.init_from, training.condition, training.cross_attention = base, modality, entry.cross_attention
    training.seed = training.batch.seed = seed
    training.batch.crops = CROPS[modality]
    options = entry.options_of(modality)
    if options:
        training.cross_attention_options[entry.cross_attention].update(options)
    training.model.attend_padding = entry.padded
    if entry.padded and modality == "text":
        training.batch.text_slots = PADDED_SLOTS
    training.update_from_flattened_dict(entry.training)
    return training


def _copy(config: Any) -> ConfigDict:
    training = ConfigDict(config.training.to_dict())
    training.records, training.autoencoder = config.records, config.autoencoder
    return training


@dataclasses.dataclass(frozen=True)
class _Run:
    """One training and its samples."""

    config: Any
    workdir: Path
    base: str
    base_hash: str
    requests: Requests
    name: str
    modality: str
    seed: int
    settings: SamplerSettings

    def result(self) -> dict[str, Any] | None:
        """The result, from now or from an earlier call; None if a signal stopped it."""
        training = run_config(self.config, self.base, ENTRIES[self.name], self.modality, self.seed)
        fields = {**json.loads(training.to_json()), "init_from": self.base_hash}
        training_hash = content_hash(json.dumps(fields, sort_keys=True))[:8]
        folder = self.workdir / "runs" / f"{self.modality}-{self.name}-{self.seed}-{training_hash}"
        result_hash = content_hash(str(FORMAT), self.requests.fingerprint, str(self.settings))[:8]
        path = folder / f"result-{result_hash}.json"
        if path.exists():
            return json.loads(path.read_text())
        trained = _trained(training, folder, self.config.fixed_scenes)
        if trained is None:
            return None
        result = self._measure(scjax.load(trained), folder, path.stem)
        write_text(path, json.dumps(result, indent=1))
        return result

    def _measure(self, model: scjax.Model, folder: Path, stem: str) -> dict[str, Any]:
        requests, entry = self.requests, ENTRIES[self.name]
        slots = PADDED_SLOTS if entry.padded and self.modality == "text" else 0
        real = measure(requests.references, requests.clusters)
        # One padded size: every mechanism has programs of its own, and each size takes as long as many steps.
        least = self.config.training.batch.buckets[0] if self.config.fixed_scenes else (0, 0)
        result: dict[str, Any] = {}
        for which, conditions in (("own", requests.own), ("shuffled", requests.shuffled)):
            if which == "shuffled" and entry.cross_attention == "none":
                result["shuffled"] = result["own"]  # the model reads no condition
                continue
            conditions, path = pad_texts(conditions, slots), folder / f"{stem}-{which}.npz"
            scenes, seconds = sample_to_file(model, conditions, self.settings, self.seed, path, least)
            loss = denoising_losses(model, requests.references, conditions, self.seed, least).mean()
            result[which] = measure_run(scenes, requests, real, float(loss))
            result["seconds_per_scene"] = seconds
        context = slots or round(requests.context)
        flops = {
            f"flops{name}": float(
                np.mean(
                    [
                        denoiser_forward(
                            model.denoiser.config, int(scene.num_lanes), int(scene.num_agents), context, cached
                        )
                        for scene in requests.references
                    ]
                )
            )
            for name, cached in (("", False), ("_cached", True))
        }
        return {
            **result,
            **flops,
            "parameters": _size(model) - _size(scjax.load(self.base)),
            "seconds_per_step": _step_seconds(folder),
        }


def _trained(training: ConfigDict, folder: Path, fixed_scenes: bool) -> str | None:
    """Folder of the trained model; trains or continues first. None if a signal stopped the training."""
    model = folder / "model"
    if not model.exists():
        objective: Any = FixedScenesObjective.from_config(training) if fixed_scenes else None
        train(training, folder, objective)
    if not model.exists():
        return None
    shutil.rmtree(folder / "checkpoints", ignore_errors=True)  # ten times the size of the model
    return str(model)


def _size(model: scjax.Model) -> int:
    return sum(np.size(leaf) for leaf in jax.tree.leaves(model.denoiser.params))


def _step_seconds(folder: Path) -> float:
    """Median seconds per step over the log; compilation and interruptions affect few lines."""
    lines: Sequence[dict[str, Any]] = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    size = json.loads((folder / "config.json").read_text())["batch"]["batch_size"]
    return statistics.median(size / line["scenes_per_second"] for line in lines if line["scope"] == "train")
