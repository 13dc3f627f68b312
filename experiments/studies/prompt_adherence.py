"""Do scenes show what their prompts ask for? One row per source of scenes, one column per attribute.

    python -m experiments.studies.prompt_adherence --model=runs/prompt/model --records=runs/synthetic \\
        --out=docs/results/prompt_adherence

Prompts are captions of held-out records. What a prompt asks for is the request that its caption states; what a scene
shows is measured by attributes (scjax.language). Rows: the model at each guidance scale; with true counts; with
--best-of, the best of several repaired samples; without energy guidance, if the model has it; without prompts at true
counts; the training scene with the nearest caption; and the record itself, which shows all. A second table shows the
realism of the scenes; single samples are judged as sampled and after scjax.repair.

Writes OUT.md, OUT.json and OUT.png.
"""

from __future__ import annotations

import dataclasses
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import scjax
from experiments.studies.page import command_line, new_figure, script_parser, table_lines, write_page
from experiments.studies.prompts import HeldOutPrompt, held_out_prompts, sample_in_calls
from scjax.data import records
from scjax.data.captions import read_captions
from scjax.diffusion.defaults import DEFAULT_GUIDANCE_SCALE
from scjax.diffusion.samplers import SAMPLERS
from scjax.encoders.text import clean_text
from scjax.evaluate.retrieval import tf_idf
from scjax.language.attributes.table import ATTRIBUTES, measure_attributes
from scjax.metrics.realism import realism
from scjax.nn.startup import start_jax
from scjax.scene import Scene

Scores = dict[str, tuple[int, int]]
"""Attribute -> (scenes that show it, scenes whose prompt asks for it)."""

REALISM = {
    "connection_gap_m": "mean connection gap [m]",
    "open_connections": "connections open by > 1 m",
    "vehicles_on_lane": "vehicles within 1.5 m of a lane",
    "scenes_vehicle_overlap": "scenes with overlapping vehicles",
    "scenes_any_overlap": "scenes with any overlap",
}
RECORD = "the record itself"


class Adherence(NamedTuple):
    """The tables of the study.

    Attributes:
      rows: source of scenes -> scores.
      realism: source of scenes -> values of ``REALISM``.
    """

    rows: dict[str, Scores]
    realism: dict[str, dict[str, float]]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.prompt_adherence", __doc__)
    add = parser.add_argument
    add("--model", required=True, dest="model_folder", metavar="DIR", help="model folder")
    add("--records", required=True, dest="folder", metavar="DIR", help="captioned and embedded records")
    add("--samples", type=int, default=500, help="prompts at most (default %(default)s)")
    add("--per-event", type=int, metavar="N", help="only prompts of rare events, at most N each (default: any prompt)")
    scales = [DEFAULT_GUIDANCE_SCALE]
    add("--guidance", type=float, nargs="+", default=scales, dest="scales", metavar="W", help="default %(default)s")
    add("--sampler", choices=SAMPLERS, help="default: the model's own")
    add("--num-steps", type=int, help="sampling steps (default: the sampler's own)")
    add("--best-of", type=int, default=1, metavar="K", help="adds a row of the best of K samples (default: none)")
    add("--seed", type=int, default=0)
    add("--out", type=Path, default=Path("prompt_adherence"), help="path without ending (default %(default)s)")
    args = parser.parse_args(arguments)
    options = vars(args)
    out = options.pop("out")
    try:
        adherence = measure(**options)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.prompt_adherence: {error}")
    title = "Prompt adherence" if args.per_event is None else "Prompt adherence on rare events"
    text = markdown(adherence, title, command_line("prompt_adherence", arguments))
    write_page(out, text, adherence._asdict(), draw(adherence.rows))
    print(text)


def measure(
    *,
    model_folder: str,
    folder: str,
    samples: int,
    scales: Sequence[float],
    sampler: str | None = None,
    num_steps: int | None = None,
    best_of: int = 1,
    seed: int = 0,
    per_event: int | None = None,
) -> Adherence:
    """Samples all rows and scores them; arguments as on the command line.

    Raises:
      ValueError: as ``held_out_prompts``.
    """
    model = scjax.load(model_folder)
    prompts = list(held_out_prompts(folder, model, samples, seed, per_event))
    requests = [prompt.request for prompt in prompts]
    rows: dict[str, Scores] = {}
    values: dict[str, dict[str, float]] = {}

    def add_row(title: str, scenes: Sequence[Scene]) -> None:
        rows[title] = scores(zip(requests, map(measure_attributes, scenes), strict=True))
        values[title] = realism(scenes)

    options: dict[str, Any] = {"model": model, "sampler": sampler, "num_steps": num_steps}
    for title, (conditions, guidance, energy_guidance) in _runs(model, prompts, scales).items():
        scenes = sample_in_calls(conditions, title, seed, **options, guidance=guidance, energy_guidance=energy_guidance)
        add_row(title, scenes)
        add_row(f"{title}, repaired", [scjax.repair(scene) for scene in scenes])
    if best_of > 1:
        title = f"prompt, guidance {scales[0]:g}, best of {best_of} repaired"
        known = {clean_text(p.text): np.asarray(p.condition.streams["text"].tokens) for p in prompts}
        options["model"] = dataclasses.replace(model, prompts={**model.prompts, **known})
        conditions = [scjax.Condition(prompt=prompt.text) for prompt in prompts]
        add_row(
            title,
            sample_in_calls(conditions, title, seed, **options, guidance=scales[0], best_of=best_of, repair=True),
        )
    nearest = _nearest_training_scenes(folder, [prompt.text for prompt in prompts])
    rows["training scene with the nearest caption"] = scores(zip(requests, nearest, strict=True))
    rows[RECORD] = scores((prompt.request, prompt.measured) for prompt in prompts)
    values[RECORD] = realism([prompt.scene for prompt in prompts])
    return Adherence(rows, values)


def _runs(
    model: scjax.Model, prompts: Sequence[HeldOutPrompt], scales: Sequence[float]
) -> dict[str, tuple[list[scjax.Condition], float, bool | None]]:
    """Title -> conditions, guidance scale, energy guidance."""
    plain = [prompt.condition for prompt in prompts]
    counts = [
        {"num_lanes": int(prompt.scene.num_lanes), "num_agents": int(prompt.scene.num_agents)} for prompt in prompts
    ]
    with_counts = [dataclasses.replace(one, **count) for one, count in zip(plain, counts, strict=True)]
    runs = {f"prompt, guidance {scale:g}": (plain, scale, None) for scale in scales}
    title = f"prompt and true counts, guidance {scales[0]:g}"
    runs[title] = with_counts, scales[0], None
    if model.energy_guidance is not None:
        runs[f"{title}, no energy guidance"] = with_counts, scales[0], False
    runs["no prompt, true counts"] = [scjax.Condition(**count) for count in counts], 1.0, None
    return runs


def scores(pairs: Iterable[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Scores:
    """Scores of scenes by the attributes that their prompts request, from pairs of request and measurements."""
    hits, total = Counter(), Counter()
    for request, measured in pairs:
        for name, value in request.items():
            hits[name] += ATTRIBUTES[name].holds(value, measured[name])
            total[name] += 1
    return {name: (hits[name], total[name]) for name in sorted(total)}


def markdown(adherence: Adherence, title: str, command: str) -> str:
    """The page: adherence in percent with the number of prompts, and realism."""
    names = sorted({name for row in adherence.rows.values() for name in row})
    table = [
        [source, *(f"{100 * row[n][0] / row[n][1]:.0f} % of {row[n][1]}" if n in row else "" for n in names)]
        for source, row in adherence.rows.items()
    ]
    lines = [f"# {title}", "", f"`{command}`", "", *table_lines(["scenes", *names], table)]
    table = [
        [source, *(_realism_cell(name, row[name]) for name in REALISM)] for source, row in adherence.realism.items()
    ]
    lines += ["", *table_lines(["scenes", *REALISM.values()], table)]
    return "\n".join(lines) + "\n"


def _realism_cell(name: str, value: float) -> str:
    if np.isnan(value):
        return ""
    return f"{value:.2f}" if name.endswith("_m") else f"{100 * value:.0f} %"


def draw(rows: dict[str, Scores]) -> Figure:
    """Share of prompts met [%]: one line per source of scenes, one column per attribute."""
    names = sorted({name for row in rows.values() for name in row})
    shares = np.array([[100 * row[n][0] / row[n][1] if n in row else np.nan for n in names] for row in rows.values()])
    figure = new_figure(5 + 0.6 * len(names), 2 + 0.3 * len(rows))
    axis = figure.subplots()
    axis.imshow(shares, vmin=0, vmax=100, cmap="Blues", aspect="auto")
    for (line, column), share in np.ndenumerate(shares):
        if np.isfinite(share):
            color = "white" if share > 60 else "black"
            axis.text(column, line, f"{share:.0f}", ha="center", va="center", fontsize=8, color=color)
    totals = [max(row[name][1] for row in rows.values() if name in row) for name in names]
    labels = [f"{name} ({total})" for name, total in zip(names, totals, strict=True)]
    axis.set_xticks(range(len(names)), labels, rotation=45, ha="right", fontsize=8)
    axis.set_yticks(range(len(rows)), list(rows), fontsize=8)
    axis.set_title("prompts met [%], in brackets their number", fontsize=9)
    return figure


def _nearest_training_scenes(folder: str, prompts: Sequence[str]) -> list[dict[str, Any]]:
    """Attributes of the training record whose caption is most similar to each prompt (tf-idf, as in retrieval)."""
    training = [(text, row) for row, caption in enumerate(read_captions(folder, "train")) for text in caption.texts]
    candidates, queries = tf_idf([text for text, _ in training], prompts)
    nearest = [int((candidates @ queries[[k]].T).toarray()[:, 0].argmax()) for k in range(len(prompts))]
    tiles = records.open_records(folder, "train")
    scenes = (records.sample_scene(records.decode_record(tiles[training[k][1]])) for k in nearest)
    return list(map(measure_attributes, scenes))


if __name__ == "__main__":
    start_jax()
    main()
