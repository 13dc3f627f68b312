"""The paper's two by two: trained with and without the collision penalty, counts from the prompt or from the data.

    python -m experiments.studies.collision_x_counts --without=runs/plain/model --with=runs/collision/model \\
        --counter=runs/counter/model --records=runs/synthetic

Both models start from the same weights and see the same batches; prompts are captions of held-back records, and every
row has the same keys. Each of the four is also sampled with steering (scjax.diffusion.energy_guidance), which does at sampling
what the penalty is to do in training. Intervals (95 %) are by bootstrap over the prompts.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import scjax
from experiments.package_model import counted
from experiments.studies.arguments import parser_of
from experiments.studies.prompt_adherence import Prompted, held_back_prompts, sampled
from scjax.language.facts import extract_facts
from scjax.language.prompt_parser import check
from scjax.metrics.realism import scene_realism
from scjax.nn.startup import start_jax
from scjax.scene import Scene
from scjax.scene.files import write_text

COLUMNS = {
    "overlap": "scenes with overlapping vehicles",
    "pairs": "overlapping pairs a scene",
    "met": "of what prompts ask",
    "lanes": "lanes off by",
    "agents": "agents off by",
}
_SHARES = ("overlap", "met")
_DRAWS = 2000

Interval = tuple[float, float, float]
"""Mean, and the ends of its interval."""


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of("two_by_two", __doc__)
    add = parser.add_argument
    add("--without", required=True, metavar="DIR", help="model folder, trained without the penalty")
    add("--with", required=True, dest="penalised", metavar="DIR", help="model folder, trained with it")
    add(
        "--counter",
        dest="count_predictor",
        metavar="DIR",
        help="model folder whose counts are taken (default: the model's own)",
    )
    add("--records", required=True, dest="folder", metavar="DIR", help="captioned and embedded records")
    add("--samples", type=int, default=200, help="prompts (default %(default)s)")
    add("--guidance", type=float, default=4.0, help="weight (default %(default)s)")
    add("--seed", type=int, default=0)
    add("--out", type=Path, default=Path("two_by_two"), help="path without ending (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        models = {"without": scjax.load(args.without), "with": scjax.load(args.penalised)}
        count_predictor = scjax.load(args.count_predictor) if args.count_predictor else None
        table = measure(
            models, count_predictor, args.folder, samples=args.samples, guidance=args.guidance, seed=args.seed
        )
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.collision_x_counts: {error}")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    write_text(args.out.with_suffix(".json"), json.dumps(table, indent=1))
    write_text(args.out.with_suffix(".md"), markdown(table))
    print(markdown(table))


def measure(
    models: dict[str, scjax.Model],
    count_predictor: scjax.Model | None,
    folder: str,
    *,
    samples: int,
    guidance: float = 4.0,
    steps: int | None = None,
    seed: int = 0,
) -> dict[str, dict[str, Interval]]:
    """Row -> column -> mean and interval.

    Raises:
      ValueError: no model tells counts from a prompt, or the counts or the records are of another text encoder.
    """
    source = count_predictor or next(iter(models.values()))
    if "count_predictor" not in source.components:
        raise ValueError("nothing tells counts from a prompt: give --counter a model folder of that stage")
    prompts = list(held_back_prompts(folder, next(iter(models.values())), samples, seed))
    told = [one.told for one in prompts]
    table = {}
    for penalty, model in models.items():
        without = model.without("count_predictor")
        for name, chosen in (("data", without), ("prompt", counted(model, source))):
            for energy_guidance in (False, True):
                title = f"{penalty} penalty, counts of the {name}{', steered' if energy_guidance else ''}"
                made = sampled(
                    told, title, seed, model=chosen, guidance=guidance, num_steps=steps, energy_guidance=energy_guidance
                )
                table[title] = _values(prompts, made, seed)
    return table


def markdown(table: dict[str, dict[str, Interval]]) -> str:
    """Rows and columns, means with their intervals."""
    lines = ["| | " + " | ".join(COLUMNS.values()) + " |", "|---" * (len(COLUMNS) + 1) + "|"]
    for title, row in table.items():
        cells = []
        for name in COLUMNS:
            percent, digits = (100, 0) if name in _SHARES else (1, 2)
            mean, low, high = (f"{percent * value:.{digits}f}" for value in row[name])
            cells.append(f"{mean} ({low} - {high}){' %' if name in _SHARES else ''}")
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _values(prompts: Sequence[Prompted], made: Sequence[Scene], seed: int) -> dict[str, Interval]:
    found = [scene_realism(scene) for scene in made]
    good = [list(check(one.asked, extract_facts(scene)).values()) for one, scene in zip(prompts, made, strict=True)]
    wrong = [
        (abs(float(scene.num_lanes - one.scene.num_lanes)), abs(float(scene.num_agents - one.scene.num_agents)))
        for one, scene in zip(prompts, made, strict=True)
    ]
    sums = {
        "overlap": [one["scenes_vehicle_overlap"] for one in found],
        "pairs": [one["vehicle_overlap_pairs"] for one in found],
        "met": [(float(sum(one)), float(len(one))) for one in good],
        "lanes": [(lanes, 1.0) for lanes, _ in wrong],
        "agents": [(agents, 1.0) for _, agents in wrong],
    }
    return {name: _interval(np.array(pairs), seed) for name, pairs in sums.items()}


def _interval(pairs: np.ndarray, seed: int) -> Interval:
    """Ratio of the sums of (numerator, denominator) [scenes, 2], and its central 95 % over resampled scenes."""
    drawn = pairs[np.random.default_rng(seed).integers(len(pairs), size=(_DRAWS, len(pairs)))].sum(1)
    ratios = drawn[:, 0] / np.maximum(drawn[:, 1], 1e-9)
    low, high = np.quantile(ratios, (0.025, 0.975))
    return float(pairs[:, 0].sum() / max(pairs[:, 1].sum(), 1e-9)), float(low), float(high)


if __name__ == "__main__":
    start_jax()
    main()
