"""Are predicted numbers of lanes and agents right, and as uncertain as the model says?

    python -m experiments.studies.count_calibration --records=runs/records --out=docs/results/count_calibration

Prompts are captions of held-out records. The page has the mean absolute error of the mean and of the mode of the
predicted distribution (and of the data's distribution, which knows no prompt), the coverage of central intervals, and
the mean -log P of the true pair. The picture shows predicted means against true numbers, and where in its predicted
distribution each true number lies (PIT); that is uniform for a calibrated model.

Writes OUT.md, OUT.json and OUT.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure

import scjax
from experiments.studies.page import command_line, new_figure, script_parser, table_lines, write_page
from experiments.studies.prompts import draw_prompt, held_out_captions
from scjax.data import records
from scjax.generate.encode import text_features
from scjax.models.counts.predictor import count_predictor
from scjax.nn.startup import start_jax

LEVELS = (0.5, 0.8, 0.9)
"""Levels of the central intervals whose coverage is measured."""
_BATCH = 64

Shares = Float[np.ndarray, "scenes numbers"]
"""Predicted probability of each number."""
Numbers = Int[np.ndarray, " scenes"]


class Predictions(NamedTuple):
    """Predicted and true numbers of lanes and agents of the held-out records.

    Attributes:
      log_probs: log P(lanes, agents) per record, [scenes, lanes + 1, agents + 1].
      prior: probabilities of the data without a prompt, [lanes + 1, agents + 1].
      true: "lanes" and "agents" -> true numbers.
    """

    log_probs: Float[np.ndarray, "scenes lanes agents"]
    prior: Float[np.ndarray, "lanes agents"]
    true: dict[str, Numbers]

    @property
    def shares(self) -> dict[str, Shares]:
        """Marginal probabilities of "lanes" and of "agents"."""
        return {"lanes": np.exp(self.log_probs).sum(2), "agents": np.exp(self.log_probs).sum(1)}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.studies.count_calibration", __doc__)
    add = parser.add_argument
    add("--model", help="model folder with a count predictor (default: the model of the package)")
    add("--records", required=True, help="captioned and embedded records")
    add("--seed", type=int, default=0, help="of the styles of the captions (default %(default)s)")
    add("--out", type=Path, default=Path("count_calibration"), help="path without ending (default %(default)s)")
    args = parser.parse_args(arguments)
    try:
        predictions = predict(args.model, args.records, args.seed)
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.studies.count_calibration: {error}")
    results = measure(predictions, args.seed)
    text = markdown(results, command_line("count_calibration", arguments))
    write_page(args.out, text, results, draw(predictions.shares, predictions.true))
    print(text)


def predict(model_folder: str | None, folder: str, seed: int) -> Predictions:
    """Predicts the counts of all held-out records from a caption.

    Raises:
      ValueError: the model has no count predictor, or another text encoder than the records.
    """
    model = scjax.load(model_folder)
    if "count_predictor" not in model.components or model.counts is None:
        raise ValueError("the model has no count predictor: train it with scjax/train/configs/counts.py")
    config, params = model.count_predictor.config, model.count_predictor.params
    captions, store = held_out_captions(folder, model)
    rng = np.random.default_rng(seed)
    tokens = [draw_prompt(store, caption, row, rng)[1] for row, caption in enumerate(captions)]
    tiles = records.open_records(folder, "val")
    scenes = [model.codec.select(records.sample_scene(records.decode_record(tiles[k]))) for k in range(len(captions))]
    program, longest = jax.jit(count_predictor(config).apply), max(map(len, tokens))
    parts = []
    for start in range(0, len(tokens), _BATCH):
        batch = tokens[start : start + _BATCH]
        batch += [batch[0]] * (_BATCH - len(batch))
        features = text_features([scjax.Stream(one) for one in batch], longest, config.text_width)
        parts.append(np.asarray(program(params, features, jnp.full(_BATCH, config.domains))))
    prior = np.asarray(model.counts).sum((0, 1)).astype(np.float64)
    true = {
        "lanes": np.minimum([int(scene.num_lanes) for scene in scenes], config.max_lanes),
        "agents": np.minimum([int(scene.num_agents) for scene in scenes], config.max_agents),
    }
    return Predictions(np.concatenate(parts)[: len(tokens)].astype(np.float64), prior / prior.sum(), true)


def measure(predictions: Predictions, seed: int) -> dict[str, dict[str, float]]:
    """Metrics of "lanes", of "agents" and of "both"; ``seed``: of the randomized PIT."""
    results = {}
    for element, axis in (("lanes", 1), ("agents", 0)):
        shares, true = predictions.shares[element], predictions.true[element]
        prior = np.broadcast_to(predictions.prior.sum(axis), shares.shape)
        results[element] = {**errors(shares, true), **coverage(shares, true, seed)}
        results[element] |= {f"{name}_without_prompt": value for name, value in errors(prior, true).items()}
    tables = predictions.log_probs
    of_truth = tables[np.arange(len(tables)), predictions.true["lanes"], predictions.true["agents"]]
    results["both"] = {"minus_log_p": float(-of_truth.mean()), "scenes": len(tables)}
    return results


def errors(shares: Shares, true: Numbers) -> dict[str, float]:
    """Mean absolute error of the mean and of the mode of the predicted distribution."""
    numbers = np.arange(shares.shape[1])
    return {
        "mae_of_mean": float(np.abs(shares @ numbers - true).mean()),
        "mae_of_mode": float(np.abs(shares.argmax(1) - true).mean()),
    }


def positions(shares: Shares, true: Numbers, seed: int) -> Float[np.ndarray, " scenes"]:
    """Randomized PIT: where in its predicted distribution each true number lies, 0..1, random within its own step.

    Uniform if the distributions are right (Czado, Gneiting & Held 2009).
    """
    cumulative = np.cumsum(shares, 1)
    rows = np.arange(len(true))
    own = shares[rows, true]
    return cumulative[rows, true] - own * np.random.default_rng(seed).random(len(true))


def coverage(shares: Shares, true: Numbers, seed: int) -> dict[str, float]:
    """Share of true numbers in each central interval of ``LEVELS``; a calibrated model covers its level."""
    distance = np.abs(positions(shares, true, seed) - 0.5)
    return {f"in_central_{100 * level:g}_percent": float((distance < level / 2).mean()) for level in LEVELS}


def markdown(results: dict[str, dict[str, float]], command: str) -> str:
    """The page: a table of all metrics."""
    metrics = list(results["lanes"])
    rows = [
        [name.replace("_", " "), *(f"{results[element][name]:.3f}" for element in ("lanes", "agents"))]
        for name in metrics
    ]
    both = results["both"]
    lines = [
        "# Calibration of predicted counts",
        "",
        f"`{command}`",
        "",
        *table_lines(["metric", "lanes", "agents"], rows),
    ]
    lines += ["", f"Mean -log P of the true pair: {both['minus_log_p']:.3f} over {both['scenes']:.0f} scenes."]
    return "\n".join(lines) + "\n"


def draw(shares: dict[str, Shares], true: dict[str, Numbers]) -> Figure:
    """Predicted means against true numbers above, PIT histograms below; a column for lanes and one for agents."""
    figure = new_figure(8, 7)
    axes = figure.subplots(2, len(shares), squeeze=False)
    for column, (element, values) in enumerate(shares.items()):
        mean, above, below = values @ np.arange(values.shape[1]), axes[0, column], axes[1, column]
        above.scatter(true[element], mean, s=6, alpha=0.4, lw=0)
        above.plot([0, true[element].max()], [0, true[element].max()], color="0.4", lw=0.8)
        above.set(title=element, xlabel="true number", ylabel="predicted mean")
        below.hist(positions(values, true[element], 0), bins=20, range=(0, 1), density=True, alpha=0.7)
        below.axhline(1, color="0.4", lw=0.8, ls="--")
        below.set(xlabel="PIT of the true number (dashed: calibrated)", ylabel="density")
    return figure


if __name__ == "__main__":
    start_jax()
    main()
