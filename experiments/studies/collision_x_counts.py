"""The two-by-two table of the paper: with and without collision loss, counts from the prompt or from the data.

    python -m experiments.studies.collision_x_counts --without=runs/plain/model --with=runs/collision/model \\
        --counts=runs/counts/model --records=runs/synthetic --out=docs/results/collision_x_counts

Both models start from the same weights and see the same batches. Prompts are captions of held-out records; all rows use
the same keys. Each of the four is also sampled with energy guidance (scjax.diffusion.energy_guidance), which reduces
collisions during sampling. Intervals (95 %) are by bootstrap over the prompts.

Writes OUT.md, OUT.json and OUT.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import scjax
from experiments.package_model import counted
from experiments.studies.page import command_line, new_figure, script_parser, table_lines, write_page
from experiments.studies.prompts import HeldOutPrompt, count_shown, held_out_prompts, sample_in_calls
from scjax.metrics.realism import scene_realism
from scjax.nn.startup import start_jax
from scjax.scene import Scene

COLUMNS = {
    "overlap": "scenes with overlapping vehicles",
    "pairs": "overlapping pairs per scene",
    "met": "requests of the prompt that are met",
    "lanes": "error of the number of lanes",
    "agents": "error of the number of agents",
}
_SHARES = ("overlap", "met")
_DRAWS = 2000

Interval = tuple[float, float, float]
"""Mean, lower and upper end of its interval."""
Table = dict[str, dict[str, Interval]]
"""Row -> column -> interval."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.collision_x_counts", __doc__)
    add = parser.add_argument
    add("--without", required=True, metavar="DIR", help="model folder, trained without the collision loss")
    add("--with", required=True, dest="with_loss", metavar="DIR", help="model folder, trained with it")
    add("--counts", metavar="DIR", help="model folder with a count predictor (default: the models' own)")
    add("--records", required=True, dest="folder", metavar="DIR", help="captioned and embedded records")
    add("--samples", type=int, default=200, help="prompts (default %(default)s)")
    add("--guidance", type=float, default=4.0, help="guidance scale (default %(default)s)")
    add("--seed", type=int, default=0)
    add("--out", type=Path, default=Path("collision_x_counts"), help="path without ending (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        models = {"without": scjax.load(args.without), "with": scjax.load(args.with_loss)}
        counts = scjax.load(args.counts) if args.counts else None
        table = measure(models, counts, args.folder, samples=args.samples, guidance=args.guidance, seed=args.seed)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.collision_x_counts: {error}")
    text = markdown(table, command_line("collision_x_counts", arguments))
    write_page(args.out, text, table, draw(table))
    print(text)


def measure(
    models: dict[str, scjax.Model],
    count_model: scjax.Model | None,
    folder: str,
    *,
    samples: int,
    guidance: float = 4.0,
    num_steps: int | None = None,
    seed: int = 0,
) -> Table:
    """Samples and measures all rows.

    Args:
      models: "without" and "with" the collision loss.
      count_model: a model with a count predictor; None: the first of ``models``.
      folder: captioned and embedded records.
      samples: number of prompts.

    Raises:
      ValueError: no model has a count predictor, or records or counts belong to another text encoder.
    """
    source = count_model or next(iter(models.values()))
    if "count_predictor" not in source.components:
        raise ValueError("no model predicts counts from a prompt: give --counts a model folder of that stage")
    prompts = list(held_out_prompts(folder, next(iter(models.values())), samples, seed))
    conditions = [prompt.condition for prompt in prompts]
    table = {}
    for loss, model in models.items():
        for origin, variant in (("data", model.without("count_predictor")), ("prompt", counted(model, source))):
            for energy_guidance in (False, True):
                title = f"{loss} collision loss, counts of the {origin}"
                title += ", energy guidance" if energy_guidance else ""
                scenes = sample_in_calls(
                    conditions,
                    title,
                    seed,
                    model=variant,
                    guidance=guidance,
                    num_steps=num_steps,
                    energy_guidance=energy_guidance,
                )
                table[title] = _intervals(prompts, scenes, seed)
    return table


def markdown(table: Table, command: str) -> str:
    """The page: means with their intervals."""
    rows = []
    for title, row in table.items():
        cells = [title]
        for name in COLUMNS:
            factor, digits = (100, 0) if name in _SHARES else (1, 2)
            mean, low, high = (f"{factor * value:.{digits}f}" for value in row[name])
            cells.append(f"{mean} ({low} - {high}){' %' if name in _SHARES else ''}")
        rows.append(cells)
    lines = ["# Collision loss and counts", "", f"`{command}`", "", *table_lines(["", *COLUMNS.values()], rows)]
    return "\n".join(lines) + "\n"


def draw(table: Table) -> Figure:
    """A panel per column with means and intervals."""
    figure = new_figure(3.0 * len(COLUMNS), 0.8 + 0.3 * len(table))
    panels = figure.subplots(1, len(COLUMNS), sharey=True)
    places = -np.arange(len(table))
    for panel, (name, title) in zip(panels, COLUMNS.items(), strict=True):
        mean, low, high = np.array([row[name] for row in table.values()]).T
        panel.errorbar(mean, places, xerr=[mean - low, high - mean], fmt="o", ms=3.5, lw=0.8)
        panel.set_title(title, fontsize=8)
        panel.tick_params(labelsize=7)
        panel.grid(axis="x", alpha=0.3, lw=0.4)
    panels[0].set_yticks(places, list(table), fontsize=7)
    return figure


def _intervals(prompts: Sequence[HeldOutPrompt], scenes: Sequence[Scene], seed: int) -> dict[str, Interval]:
    ratios = [scene_realism(scene) for scene in scenes]
    errors = {
        name: [
            (abs(float(getattr(scene, field) - getattr(prompt.scene, field))), 1.0)
            for prompt, scene in zip(prompts, scenes, strict=True)
        ]
        for name, field in (("lanes", "num_lanes"), ("agents", "num_agents"))
    }
    pairs = {
        "overlap": [ratio["scenes_vehicle_overlap"] for ratio in ratios],
        "pairs": [ratio["vehicle_overlap_pairs"] for ratio in ratios],
        "met": [count_shown(scene, prompt.request) for prompt, scene in zip(prompts, scenes, strict=True)],
        **errors,
    }
    return {name: _interval(np.array(values), seed) for name, values in pairs.items()}


def _interval(pairs: np.ndarray, seed: int) -> Interval:
    """Ratio of the sums of (numerator, denominator) [scenes, 2], and its central 95 % over bootstrap samples."""
    samples = pairs[np.random.default_rng(seed).integers(len(pairs), size=(_DRAWS, len(pairs)))].sum(1)
    ratios = samples[:, 0] / np.maximum(samples[:, 1], 1e-9)
    low, high = np.quantile(ratios, (0.025, 0.975))
    return float(pairs[:, 0].sum() / max(pairs[:, 1].sum(), 1e-9)), float(low), float(high)


if __name__ == "__main__":
    start_jax()
    main()
