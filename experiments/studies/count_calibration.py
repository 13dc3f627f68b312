"""Are the numbers of lanes and agents that a model expects of a prompt right, and as uncertain as it says?

    python -m experiments.studies.count_calibration --model=runs/prompt/model --records=runs/records --out=calibration

Prompts are captions of held-back records. ``calibration.json`` has the mean absolute error of the expected and of the
likeliest number (and of the data's own table, which knows no prompt), the coverage of central intervals, and the mean
-log P of the true pair; ``calibration.png`` draws expected against true numbers and where in its distribution the truth
lies, which is uniform for a calibrated model.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import scjax
from experiments.studies.arguments import parser_of
from experiments.studies.prompt_adherence import a_prompt, held_back
from scjax.data import records
from scjax.generate.conditions import Stream
from scjax.generate.encode import text_features
from scjax.models.counts.predictor import count_predictor
from scjax.nn.startup import start_jax
from scjax.scene.files import write_text
from scjax.viz.grid import save_figure

LEVELS = (0.5, 0.8, 0.9)
"""Of the central intervals whose coverage is told."""
_AT_ONCE = 64

Shares = Float[np.ndarray, "scenes numbers"]
Numbers = Int[np.ndarray, " scenes"]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = parser_of("calibration", __doc__)
    add = parser.add_argument
    add("--model", help="model folder with a counter (default: the one that ships)")
    add("--records", required=True, help="captioned and embedded records")
    add("--seed", type=int, default=0, help="of the styles of the captions (default %(default)s)")
    add("--out", type=Path, default=Path("calibration"), help="path without ending (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        found, told, true = measure(args.model, args.records, args.seed)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.count_calibration: {error}")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    write_text(args.out.with_suffix(".json"), json.dumps(found, indent=1))
    draw(told, true, args.out.with_suffix(".png"))
    print(json.dumps(found, indent=1))


def measure(
    model_folder: str | None, folder: str, seed: int
) -> tuple[dict[str, dict[str, float]], dict[str, Shares], dict[str, Numbers]]:
    """What -> metric -> value; what -> probabilities of each number of a prompt; what -> true numbers.

    Raises:
      ValueError: the model has no counter, or reads another encoder's tokens than the records have.
    """
    model = scjax.load(model_folder)
    if "count_predictor" not in model.components or model.counts is None:
        raise ValueError("the model has no counter: train it with scjax/train/configs/counts.py")
    config = model.count_predictor.config
    captions, store = held_back(folder, model)
    rng = np.random.default_rng(seed)
    tokens = [a_prompt(store, caption, row, rng)[1] for row, caption in enumerate(captions)]
    tiles = records.open_records(folder, "val")
    scenes = [model.codec.select(records.sample_scene(records.decode_record(tiles[k]))) for k in range(len(captions))]
    true = {
        "lanes": np.minimum([int(scene.num_lanes) for scene in scenes], config.max_lanes),
        "agents": np.minimum([int(scene.num_agents) for scene in scenes], config.max_agents),
    }
    program = jax.jit(count_predictor(config).apply)
    parts = []
    for start in range(0, len(tokens), _AT_ONCE):
        part = tokens[start : start + _AT_ONCE]
        part += [part[0]] * (_AT_ONCE - len(part))
        features = text_features([Stream(one) for one in part], max(map(len, tokens)), config.text_width)
        parts.append(np.asarray(program(model.count_predictor.params, features, jnp.full(_AT_ONCE, config.domains))))
    tables = np.concatenate(parts)[: len(tokens)].astype(np.float64)
    told = {"lanes": np.exp(tables).sum(2), "agents": np.exp(tables).sum(1)}
    prior = model.counts.sum((0, 1)).astype(np.float64)
    prior /= prior.sum()
    found = {}
    for what, axis in (("lanes", 1), ("agents", 0)):
        blind = np.broadcast_to(prior.sum(axis), told[what].shape)
        found[what] = {**errors(told[what], true[what]), **coverage(told[what], true[what], seed)}
        found[what] |= {f"{name}_without_prompt": value for name, value in errors(blind, true[what]).items()}
    chosen = tables[np.arange(len(tables)), true["lanes"], true["agents"]]
    found["both"] = {"minus_log_p": float(-chosen.mean()), "scenes": len(tables)}
    return found, told, true


def errors(shares: Shares, true: Numbers) -> dict[str, float]:
    """Mean absolute error of the expected and of the likeliest number."""
    numbers = np.arange(shares.shape[1])
    return {
        "mae_of_mean": float(np.abs(shares @ numbers - true).mean()),
        "mae_of_mode": float(np.abs(shares.argmax(1) - true).mean()),
    }


def positions(shares: Shares, true: Numbers, seed: int) -> Float[np.ndarray, " scenes"]:
    """Where in its distribution each true number lies, 0..1, drawn within the number's own step (randomised PIT).

    Uniform if the distributions are right (Czado, Gneiting & Held 2009).
    """
    reached = np.cumsum(shares, 1)
    rows = np.arange(len(true))
    own = shares[rows, true]
    return reached[rows, true] - own * np.random.default_rng(seed).random(len(true))


def coverage(shares: Shares, true: Numbers, seed: int) -> dict[str, float]:
    """Share of true numbers in each central interval of ``LEVELS``; of a calibrated model that is the level."""
    off = np.abs(positions(shares, true, seed) - 0.5)
    return {f"in_central_{100 * level:g}_percent": float((off < level / 2).mean()) for level in LEVELS}


def draw(told: dict[str, Shares], true: dict[str, Numbers], path: Path) -> Figure:
    """Expected against true numbers above, positions below; a column for lanes and one for agents."""
    figure = Figure(figsize=(8, 7), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(told), squeeze=False)
    for column, (what, shares) in enumerate(told.items()):
        expected, above, below = shares @ np.arange(shares.shape[1]), axes[0, column], axes[1, column]
        above.scatter(true[what], expected, s=6, alpha=0.4, lw=0)
        above.plot([0, true[what].max()], [0, true[what].max()], color="0.4", lw=0.8)
        above.set(title=what, xlabel="in the scene", ylabel="expected of its caption")
        below.hist(positions(shares, true[what], 0), bins=20, range=(0, 1), density=True, alpha=0.7)
        below.axhline(1, color="0.4", lw=0.8, ls="--")
        below.set(xlabel="position of the truth (dashed: calibrated)", ylabel="density")
    save_figure(figure, path, dpi=100)
    return figure


if __name__ == "__main__":
    start_jax()
    main()
