"""How few steps will do? A row a sampler, number of steps and guidance weight: metrics with intervals, seconds a scene.

    python -m experiments.studies.samplers --model=runs/prompt/model --records=runs/records --out=runs/sweep

Scenes are made for held-back records, at their numbers of lanes and agents and, where the model reads text, for one of
their captions; every row from the same keys. OUT gets a file a row (the same command goes on where it was stopped),
sweep.json, sweep.md and sweep.png. Printed is the setting with the fewest evaluations of the network that can't be
told to be worse than the reference in any of 16 metrics, at 95 % for all of them together: 100 steps of ddpm (of heun
for a rectified flow), under the first guidance weight and in the first precision. --again makes the reference anew
from other noise: what is worse there is worse by chance.
"""

from __future__ import annotations

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
from experiments.studies.arguments import parser_of
from experiments.studies.prompt_adherence import a_prompt, held_back
from experiments.studies.samplers_report import METRICS, draw, markdown, verdict, worse
from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE
from scjax.diffusion.samplers import SAMPLERS, resolve_sampler
from scjax.evaluate.generated import weights_hash
from scjax.evaluate.hashing import content_hash, row_text
from scjax.evaluate.requests import counts_request
from scjax.evaluate.sources import RecordScenes
from scjax.generate.batching import padded_size
from scjax.generate.encode import padded_length
from scjax.language.facts import extract_facts
from scjax.language.prompt_parser import PromptSpec, check, parse_prompt
from scjax.metrics.cluster_sums import ClusterSums, bootstrap_intervals
from scjax.metrics.distributions import Sums
from scjax.metrics.measure import distribution_values, extra_values, measure, scene_values
from scjax.metrics.pooling import Values
from scjax.nn.cpu.precision import Compute
from scjax.nn.startup import start_jax
from scjax.scene import Scene
from scjax.scene.files import write_text

FORMAT = 2  # of a row's file; to be raised when what it holds changes
STEPS = (4, 6, 10, 16, 25, 50, 100)
REFERENCE = {"noise": "ddpm", "velocity": "ddpm", "flow": "heun"}
CALL = 128  # scenes a call of the sampler: the progress bar moves that often


@dataclasses.dataclass(frozen=True)
class Requests:
    """What every row is made for.

    Attributes:
      references: recorded scenes, and their locations.
      conditions: one a scene.
      asked: what each prompt asks for; empty without prompts.
      fingerprint: changes with all of it.
    """

    references: list[Scene]
    clusters: list[str]
    conditions: list[scjax.Condition]
    asked: list[PromptSpec]
    fingerprint: str


class Setting(NamedTuple):
    """What a row is made with."""

    sampler: str
    steps: int
    guidance: float
    compute: Compute
    again: int = 0  # another draw of the noise

    def ending(self, weights: bool, computes: bool) -> str:
        """Of the row's name: the weight and the precision where there are several."""
        told = (f", guidance {self.guidance:g}" if weights else "") + (f", {self.compute}" if computes else "")
        return told + (f", again {self.again}" if self.again else "")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of("sweep_samplers", __doc__)
    add = parser.add_argument
    add("--model", required=True, help="model folder")
    add("--records", default="runs/records", help="records, for prompts captioned and embedded (default: %(default)s)")
    add("--out", type=Path, default=Path("runs/sweep"), help="folder (default: %(default)s)")
    add("--samples", type=int, default=500, metavar="N", help="scenes a row at most (default: %(default)s)")
    add("--samplers", nargs="+", metavar="NAME", help=f"of {', '.join(SAMPLERS)} (default: all that fit the model)")
    add("--steps", type=int, nargs="+", default=list(STEPS), metavar="S", help="(default: %(default)s)")
    add("--guidance", type=float, nargs="+", metavar="W", help="weights (default: that of scjax.sample)")
    add(
        "--compute",
        nargs="+",
        default=["float32"],
        choices=get_args(Compute),
        metavar="C",
        help=f"operands of the products, of {', '.join(get_args(Compute))} (default: float32)",
    )
    add("--again", type=int, default=0, metavar="N", help="rows of the reference from other noise (default: none)")
    add("--seed", type=int, default=0, help="another seed, other scenes (default: %(default)s)")
    args = parser.parse_args(arguments)
    try:
        print(sweep(args))
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.samplers: {error}")


def sweep(args) -> str:
    """Makes the rows that are missing and writes the reports; returns the verdict.

    Raises:
      ValueError: no such model or records, records whose text the model does not read, or a sampler that does not fit.
    """
    model = scjax.load(args.model)
    if "denoiser" not in model.components:
        raise ValueError(f"{args.model} has no denoiser: give the model folder of that stage")
    prediction = model.denoiser.config.prediction
    fitting = [name for name, one in SAMPLERS.items() if prediction in one.default_steps]
    names = [resolve_sampler(name, prediction).name for name in args.samplers or fitting]
    weights = args.guidance or [1.0 if model.denoiser.config.condition is None else DEFAULT_GUIDANCE_SCALE]
    reference = Setting(REFERENCE[prediction], 100, weights[0], args.compute[0])
    combined = itertools.product(args.compute, weights, names, sorted(args.steps))
    anew = [reference._replace(again=k) for k in range(1, args.again + 1)]
    settings = dict.fromkeys([reference, *anew, *(Setting(n, s, w, c) for c, w, n, s in combined)])
    requests = requests_of(model, args.records, args.samples, args.seed)
    real = measure(requests.references, requests.clusters).cluster_sums
    args.out.mkdir(parents=True, exist_ok=True)
    weights_of_model, rows = weights_hash(model), []
    with tqdm(total=len(settings) * len(requests.conditions), unit="scene", disable=None) as bar:
        for setting in settings:
            name, steps = setting.sampler, setting.steps
            ending = setting.ending(len(weights) > 1, len(args.compute) > 1)
            title = f"{name} {steps}{ending}"
            bar.set_description(title)
            key = content_hash(str(FORMAT), weights_of_model, requests.fingerprint, repr(SAMPLERS[name]), str(setting))
            path = args.out / f"{name}-{steps}-{setting.guidance:g}-{setting.compute}-{key}.json"
            if path.exists():
                bar.update(len(requests.conditions))
            else:
                row = {**setting._asdict(), "evaluations": SAMPLERS[name].num_evaluations(steps)}
                row |= measured(model, requests, real, setting, args.seed, bar)
                write_text(path, json.dumps(row, indent=1))
                # A program is 1,200 areas of memory here, and Linux ends a process that wants more than 65,530.
                jax.clear_caches()
            rows.append({"name": title, "series": name + ending, **json.loads(path.read_text())})
    told = verdict(rows, rows[0])
    kept = [{**{k: v for k, v in row.items() if k != "drawn"}, "worse": worse(row, rows[0])} for row in rows]
    content = {"rows": kept, "reference": rows[0]["name"], "verdict": told}
    write_text(args.out / "sweep.json", json.dumps(content, indent=1))
    write_text(args.out / "sweep.md", markdown(rows, rows[0]) + f"\n{told}\n")
    draw(rows, rows[0], args.out / "sweep.png")
    return told


def requests_of(model: scjax.Model, folder: str, samples: int, seed: int) -> Requests:
    """Held-back records, evenly chosen, and what is asked of the model for each."""
    source = RecordScenes(folder, "val")
    places = source.clusters
    if not places:
        raise ValueError(f"{folder} has no held-back records: build them with a larger share (--split-percent)")
    rows = np.unique(np.linspace(0, len(places) - 1, min(samples, len(places))).astype(int))
    references = source.read(rows.tolist())
    conditions = [
        counts_request(model, scene, source.domains[int(scene.domain)] if source.domains else None)
        for scene in references
    ]
    asked: list[PromptSpec] = []
    told = ""
    if model.text_encoder:
        (captions, store), rng = held_back(folder, model), np.random.default_rng(seed)
        prompts = [a_prompt(store, captions[row], int(row), rng) for row in rows]
        asked, told = [parse_prompt(text) for text, _ in prompts], "\n".join(text for text, _ in prompts)
        conditions = [
            dataclasses.replace(cond, streams={"text": scjax.Stream(tokens)})
            for cond, (_, tokens) in zip(conditions, prompts, strict=True)
        ]
    fingerprint = content_hash(source.fingerprint, row_text(rows), str(seed), told)
    return Requests(references, [places[row] for row in rows], conditions, asked, fingerprint)


def measured(
    model: scjax.Model, requests: Requests, real: ClusterSums, setting: Setting, seed: int, bar: tqdm
) -> dict[str, Any]:
    """Metrics of a setting with intervals and draws of locations, and its seconds a scene without compilation."""
    how: dict[str, Any] = setting._asdict()
    config = dataclasses.replace(model.denoiser.config, compute=how.pop("compute"))
    again, how["num_steps"] = how.pop("again"), how.pop("steps")
    model = model.with_component("denoiser", config, model.denoiser.params)
    programs = {  # what decides which program makes a scene: its bucket and the slots of its text
        (
            padded_size(cond.num_agents or 1, cond.num_lanes or 1),
            padded_length(len(cond.streams["text"].tokens) if "text" in cond.streams else 0),
        ): cond
        for cond in requests.conditions
    }
    for cond in programs.values():  # two scenes are padded to a whole group
        scjax.sample(jax.random.key(0), [cond] * 2, model=model, **how)
    scenes, seconds = [], 0.0
    for start in range(0, len(requests.conditions), CALL):
        part = requests.conditions[start : start + CALL]
        part = part * 2 if len(part) == 1 else part
        key = jax.random.fold_in(jax.random.key(seed), start)
        key = jax.random.fold_in(key, again) if again else key
        begin = time.perf_counter()
        made = scjax.sample(key, part, model=model, **how)
        seconds += time.perf_counter() - begin
        scenes += made[: len(requests.conditions) - start]
        bar.update(len(scenes) - start)
    cluster_sums = measure(scenes, requests.clusters).cluster_sums
    if requests.asked:
        prompts = ClusterSums()
        for asked, scene, cluster in zip(requests.asked, scenes, requests.clusters, strict=True):
            hits = list(check(asked, extract_facts(scene)).values())
            prompts.add({"extra/prompt": np.array([sum(hits), len(hits)], np.float64)}, cluster)
        cluster_sums = ClusterSums(
            {name: sums | prompts.clusters[name] for name, sums in cluster_sums.clusters.items()}
        )
    values, drawn = _table(cluster_sums.total, real.total), cluster_sums.bootstrap_samples(real, _table)
    found = {
        name: {"value": values[name], "low": low, "high": high}
        for name, (low, high) in bootstrap_intervals(values, drawn).items()
    }
    rounded = {name: [float(f"{x:.6g}") for x in column] for name, column in drawn.items()}
    return {"seconds": seconds / len(scenes), "scenes": len(scenes), "metrics": found, "drawn": rounded}


def _table(ours: Sums, theirs: Sums) -> Values:
    values = distribution_values(ours, theirs, "strict") | scene_values(ours) | extra_values(ours)
    return {name: values.get(name, math.nan) for name in METRICS}


if __name__ == "__main__":
    start_jax()
    main()
