"""How few sampling steps suffice? One row per sampler, number of steps and guidance scale.

    python -m experiments.studies.samplers --model=runs/prompt/model --records=runs/records --workdir=runs/samplers \\
        --out=docs/results/samplers

Scenes are sampled for held-out records, at their numbers of lanes and agents. If the model reads attributes, a random
request that the record fulfills goes with it; if it reads text alone, one of its captions. All rows use the same keys.
The verdict names the setting with the fewest network evaluations that is not significantly worse than the reference in
any of 16 metrics (95 % for all metrics together). The reference takes 100 steps of ddpm (of heun for a rectified flow)
at the first guidance scale and in the first precision. --repeats samples the reference again from other noise, to show
what chance alone does.

WORKDIR keeps a file per row; the same command continues an interrupted run. Writes OUT.md, OUT.json and OUT.png.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

import jax
import numpy as np
from tqdm import tqdm

import scjax
from experiments.studies.page import command_line, script_parser, write_page
from experiments.studies.prompts import count_shown, draw_prompt, held_out_captions
from experiments.studies.samplers_report import METRICS, draw, markdown, verdict, worse_metrics
from scjax.data.measurements import MeasuredRecords
from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE
from scjax.diffusion.samplers import SAMPLERS, resolve_sampler
from scjax.evaluate.generated import weights_hash
from scjax.evaluate.hashing import content_hash, row_text
from scjax.evaluate.requests import counts_request
from scjax.evaluate.sources import RecordScenes
from scjax.generate.batching import padded_size
from scjax.generate.encode import padded_length
from scjax.language.attributes.draw import draw_attributes
from scjax.metrics.cluster_sums import ClusterSums, bootstrap_intervals
from scjax.metrics.distributions import Sums
from scjax.metrics.measure import distribution_values, extra_values, measure, scene_values
from scjax.metrics.pooling import Values
from scjax.nn.cpu.precision import Compute
from scjax.nn.startup import start_jax
from scjax.scene import Scene
from scjax.scene.files import write_text

FORMAT = 4  # of a row's file; raise it when its content changes
STEPS = (4, 6, 10, 16, 25, 50, 100)
REFERENCE_STEPS = 100
REFERENCE = {"noise": "ddpm", "velocity": "ddpm", "flow": "heun"}
_SCENES_PER_CALL = 128  # the progress bar moves that often


@dataclasses.dataclass(frozen=True)
class Requests:
    """What all rows are sampled for.

    Attributes:
      references: recorded scenes.
      clusters: their locations.
      conditions: one per scene.
      requests: what is requested of each; empty if nothing is.
      fingerprint: a hash of all of it.
    """

    references: list[Scene]
    clusters: list[str]
    conditions: list[scjax.Condition]
    requests: list[dict[str, Any]]
    fingerprint: str


class Setting(NamedTuple):
    """How a row is sampled; ``repeat``: number of another draw of the noise."""

    sampler: str
    num_steps: int
    guidance: float
    compute: Compute
    repeat: int = 0

    def suffix(self, several_scales: bool, several_precisions: bool) -> str:
        """End of the row's name: guidance scale and precision where there are several."""
        scale = f", guidance {self.guidance:g}" if several_scales else ""
        precision = f", {self.compute}" if several_precisions else ""
        return scale + precision + (f", repeat {self.repeat}" if self.repeat else "")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.samplers", __doc__)
    add = parser.add_argument
    add("--model", required=True, help="model folder")
    add("--records", default="runs/records", help="records, for prompts captioned and embedded (default: %(default)s)")
    add("--workdir", type=Path, default=Path("runs/samplers"), help="folder of the rows (default: %(default)s)")
    add("--out", type=Path, help="path without ending (default: WORKDIR/samplers)")
    add("--samples", type=int, default=500, metavar="N", help="scenes per row at most (default: %(default)s)")
    add("--samplers", nargs="+", metavar="NAME", help=f"of {', '.join(SAMPLERS)} (default: all that fit the model)")
    add("--num-steps", type=int, nargs="+", default=list(STEPS), metavar="S", help="(default: %(default)s)")
    add("--guidance", type=float, nargs="+", metavar="W", help="guidance scales (default: that of scjax.sample)")
    precisions = get_args(Compute)
    add(
        "--compute", nargs="+", default=["float32"], choices=precisions, metavar="C", help=f"of {', '.join(precisions)}"
    )
    add("--repeats", type=int, default=0, metavar="N", help="rows of the reference from other noise (default: none)")
    add("--reference-steps", type=int, default=REFERENCE_STEPS, help="steps of the reference (default: %(default)s)")
    add("--seed", type=int, default=0, help="of prompts and keys (default: %(default)s)")
    args = parser.parse_args(arguments)
    try:
        rows = sweep(args)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.samplers: {error}")
    reference, conclusion = rows[0], verdict(rows, rows[0])
    public = [{k: v for k, v in row.items() if k != "bootstrap"} for row in rows]
    content = {
        "rows": [{**row, "worse": worse_metrics(full, reference)} for row, full in zip(public, rows, strict=True)],
        "reference": reference["name"],
        "verdict": conclusion,
    }
    text = markdown(rows, reference, command_line("samplers", arguments), conclusion)
    write_page(args.out or args.workdir / "samplers", text, content, draw(rows, reference))
    print(conclusion)


def sweep(args: argparse.Namespace) -> list[dict[str, Any]]:
    """All rows, the reference first; samples those that are missing in the work folder.

    Raises:
      ValueError: no such model or records, text that the model does not read, or a sampler that does not fit.
    """
    model = scjax.load(args.model)
    config = model.denoiser.config
    fitting = [name for name, sampler in SAMPLERS.items() if config.prediction in sampler.default_steps]
    names = [resolve_sampler(name, config.prediction).name for name in args.samplers or fitting]
    scales = args.guidance or [DEFAULT_GUIDANCE_SCALE if config.is_conditional else 1.0]
    reference = Setting(REFERENCE[config.prediction], args.reference_steps, scales[0], args.compute[0])
    repeats = [reference._replace(repeat=k) for k in range(1, args.repeats + 1)]
    combinations = itertools.product(args.compute, scales, names, sorted(args.num_steps))
    settings = dict.fromkeys([reference, *repeats, *(Setting(n, s, w, c) for c, w, n, s in combinations)])
    requests = make_requests(model, args.records, args.samples, args.seed)
    real = measure(requests.references, requests.clusters).cluster_sums
    args.workdir.mkdir(parents=True, exist_ok=True)
    model_hash, rows = weights_hash(model), []
    with tqdm(total=len(settings) * len(requests.conditions), unit="scene", disable=None) as bar:
        for setting in settings:
            sampler, suffix = SAMPLERS[setting.sampler], setting.suffix(len(scales) > 1, len(args.compute) > 1)
            title = f"{setting.sampler} {setting.num_steps}{suffix}"
            bar.set_description(title)
            key = content_hash(str(FORMAT), model_hash, requests.fingerprint, repr(sampler), str(setting))
            stem = f"{setting.sampler}-{setting.num_steps}-{setting.guidance:g}-{setting.compute}"
            path = args.workdir / f"{stem}-{key}.json"
            if path.exists():
                bar.update(len(requests.conditions))
            else:
                row = {**setting._asdict(), "evaluations": len(sampler.evaluated_levels(setting.num_steps))}
                row |= measure_setting(model, requests, real, setting, args.seed, bar)
                write_text(path, json.dumps(row, indent=1))
                # A program takes some 1,200 memory areas here, and Linux ends a process with more than 65,530.
                jax.clear_caches()
            rows.append({"name": title, "series": setting.sampler + suffix, **json.loads(path.read_text())})
    return rows


def make_requests(model: scjax.Model, folder: str, samples: int, seed: int) -> Requests:
    """Evenly spaced held-out records, and the conditions that the model gets for them.

    Raises:
      ValueError: there are no held-out records, or the model does not read their text features.
    """
    source = RecordScenes(folder, "val")
    locations = source.clusters
    if not locations:
        raise ValueError(f"{folder} has no held-out records: build them with a larger share (--split-percent)")
    rows = np.unique(np.linspace(0, len(locations) - 1, min(samples, len(locations))).astype(int))
    references = source.read(rows.tolist())
    domains = [source.domains[int(scene.domain)] if source.domains else None for scene in references]
    conditions = [counts_request(model, *pair) for pair in zip(references, domains, strict=True)]
    requests: list[dict[str, Any]] = []
    words = ""
    if model.denoiser.config.attributes:
        measured = MeasuredRecords(folder, "val")
        requests = [draw_attributes(measured[int(row)], np.random.default_rng([seed, int(row)])) for row in rows]
        words = str(requests)
        conditions = [
            dataclasses.replace(condition, attributes=request)
            for condition, request in zip(conditions, requests, strict=True)
        ]
    elif model.text_encoder:
        (captions, store), rng = held_out_captions(folder, model), np.random.default_rng(seed)
        prompts = [draw_prompt(store, captions[row], int(row), rng) for row in rows]
        requests, words = [one.request for one, _ in prompts], "\n".join(one.text for one, _ in prompts)
        conditions = [
            dataclasses.replace(condition, streams={"text": scjax.Stream(tokens)})
            for condition, (_, tokens) in zip(conditions, prompts, strict=True)
        ]
    fingerprint = content_hash(source.fingerprint, row_text(rows), str(seed), words)
    return Requests(references, [locations[row] for row in rows], conditions, requests, fingerprint)


def measure_setting(
    model: scjax.Model, requests: Requests, real: ClusterSums, setting: Setting, seed: int, bar: tqdm
) -> dict[str, Any]:
    """Metrics of a setting with intervals and bootstrap samples, and seconds per scene without compilation."""
    config = dataclasses.replace(model.denoiser.config, compute=setting.compute)
    model = model.with_component("denoiser", config, model.denoiser.params)
    scenes, seconds = _sample(model, requests, setting, seed, bar)
    cluster_sums = measure(scenes, requests.clusters).cluster_sums
    if requests.requests:
        prompts = ClusterSums()
        for request, scene, cluster in zip(requests.requests, scenes, requests.clusters, strict=True):
            prompts.add({"extra/prompt": np.array(count_shown(scene, request))}, cluster)
        cluster_sums = ClusterSums(
            {name: sums | prompts.clusters[name] for name, sums in cluster_sums.clusters.items()}
        )
    values, samples = _table(cluster_sums.total, real.total), cluster_sums.bootstrap_samples(real, _table)
    intervals = bootstrap_intervals(values, samples)
    return {
        "seconds": seconds,
        "scenes": len(scenes),
        "metrics": {name: {"value": values[name], "low": low, "high": high} for name, (low, high) in intervals.items()},
        "bootstrap": {name: [float(f"{x:.6g}") for x in column] for name, column in samples.items()},
    }


def _sample(
    model: scjax.Model, requests: Requests, setting: Setting, seed: int, bar: tqdm
) -> tuple[list[Scene], float]:
    """Scenes of all conditions, and seconds per scene; every program is compiled before the clock starts."""
    options: dict[str, Any] = {
        "model": model,
        "sampler": setting.sampler,
        "num_steps": setting.num_steps,
        "guidance": setting.guidance,
    }
    programs = {}  # a program per bucket and number of text slots
    for condition in requests.conditions:
        tokens = len(condition.streams["text"].tokens) if "text" in condition.streams else 0
        bucket = padded_size(condition.num_agents or 1, condition.num_lanes or 1)
        programs[bucket, padded_length(tokens)] = condition
    for condition in programs.values():  # two scenes are padded to a whole batch
        scjax.sample(jax.random.key(0), [condition] * 2, **options)
    scenes, seconds = [], 0.0
    for start in range(0, len(requests.conditions), _SCENES_PER_CALL):
        part = requests.conditions[start : start + _SCENES_PER_CALL]
        part = part * 2 if len(part) == 1 else part
        key = jax.random.fold_in(jax.random.key(seed), start)
        key = jax.random.fold_in(key, setting.repeat) if setting.repeat else key
        begin = time.perf_counter()
        samples = scjax.sample(key, part, **options)
        seconds += time.perf_counter() - begin
        scenes += samples[: len(requests.conditions) - start]
        bar.update(len(scenes) - start)
    return scenes, seconds / len(scenes)


def _table(ours: Sums, real: Sums) -> Values:
    values = distribution_values(ours, real, "strict") | scene_values(ours) | extra_values(ours)
    return {name: values.get(name, math.nan) for name in METRICS}


if __name__ == "__main__":
    start_jax()
    main()
