"""Trains the reader of prompts on texts of the grammar and on written prompts, each with the request that it makes.

    nice -n 15 python -m experiments.train_reader runs/reader

Composes texts, encodes them once with the frozen multilingual encoder, and trains the network on them. The same
command continues where it was stopped (Ctrl-C and SIGTERM save first). runs/reader/model is the reader of the last
evaluation: a mean of the weights of --start and of the trained ones (Wortsman et al. 2022), calibrated on prompts that
were held back.
"""

from __future__ import annotations

import functools
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from tqdm import tqdm

from experiments.reader_calibration import calibrate, reader_losses
from experiments.reader_texts import Texts, reader_texts
from experiments.studies.page import script_parser
from experiments.studies.reading import compare_readings, summarize
from scjax.encoders.e5 import E5
from scjax.encoders.text import FrozenTextEncoder, load_text_encoder
from scjax.generate.prompt_reader import ENCODER_LAYERS, PromptReader, load_reader, reader_config, save_reader
from scjax.language.grammar.prompts import written_prompts
from scjax.language.reader.targets import read_outputs
from scjax.models.reader import ReaderConfig, ReaderOutputs, reader_network
from scjax.nn.functional import Params
from scjax.scene.files import locked_folder
from scjax.train.checkpoint import Checkpoints, check_resume
from scjax.train.loop import stop_signals
from scjax.train.optimizer import adamw

_BATCH = 32


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.train_reader", __doc__)
    parser.add_argument("folder", type=Path, help="receives features, checkpoints and the model")
    parser.add_argument("--texts", type=int, default=48_000, help="texts of the grammar")
    parser.add_argument("--copies", type=int, default=3, help="of every written prompt, with other typing mistakes")
    parser.add_argument("--prompt-share", type=float, default=0.5, help="share of a batch that is written prompts")
    parser.add_argument("--start", type=Path, help="folder of a reader to begin with (default: fresh weights)")
    parser.add_argument(
        "--keep-start", type=float, default=0.3, help="share of the weights of --start in the reader that is saved"
    )
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--held-back", type=int, default=1000, help="composed texts that are only evaluated")
    parser.add_argument("--steps", type=int, default=12_000)
    parser.add_argument("--evaluate-every", type=int, default=1000)
    args = parser.parse_args(arguments)
    if not 0 < args.held_back < args.texts:
        parser.error(f"--held-back is {args.held_back}: give a number between 0 and the {args.texts} texts")
    if args.copies < 1:
        parser.error(f"--copies is {args.copies}: give 1 or more")
    if not 0 <= args.prompt_share < 1:
        parser.error(f"--prompt-share is {args.prompt_share}: give a share from 0 to below 1")
    if not 0 <= args.keep_start < 1:
        parser.error(f"--keep-start is {args.keep_start}: give a share from 0 to below 1")
    encoder = load_text_encoder(E5, layers=ENCODER_LAYERS)
    with locked_folder(args.folder), stop_signals() as stop:
        texts, digest = reader_texts(
            args.folder / "features",
            encoder,
            composed=args.texts,
            copies=args.copies,
            held_back=args.held_back,
            seed=args.seed,
            stop=stop,
        )
        if not stop:
            run = {name: value for name, value in vars(args).items() if name not in ("folder", "start", "keep_start")}
            check_resume(args.folder / "checkpoints", run, {"texts": digest})
            with Checkpoints(args.folder / "checkpoints", run, {"texts": digest}) as checkpoints:
                _train(args.folder / "model", encoder, texts, args, checkpoints, stop)


def _train(
    folder: Path, encoder: FrozenTextEncoder, texts: Texts, args: Any, checkpoints: Checkpoints, stop: list[int]
) -> None:
    config = reader_config(encoder.width)
    optimizer, step = _optimizer_and_step(config, args.steps)
    first_params = _first_params(config, args.start, args.seed)
    state, first = (first_params, optimizer.init(first_params)), checkpoints.latest or 0
    if first:
        state, _ = checkpoints.restore(state)
    kept = args.keep_start if args.start else 0.0

    def save(number: int) -> dict[str, Any]:
        """Writes the reader and returns how well it reads."""
        weights = jax.device_get((first_params, state[0]))  # on the host: a device compiles a program for every shape
        params = jax.device_put(jax.tree.map(lambda old, new: kept * old + (1 - kept) * new, *weights))
        outputs = {kind: _outputs(config, params, texts, rows) for kind, rows in texts.held_back.items()}
        values = {kind: _evaluate(some, texts, texts.held_back[kind]) for kind, some in outputs.items()}
        params = calibrate(params, outputs["prompts"], [texts.targets[row] for row in texts.held_back["prompts"]])
        notes = {"texts": args.texts, "prompts": len(written_prompts()), "seed": args.seed, "steps": number}
        save_reader(PromptReader(config, params, encoder.name), folder, {**notes, "validation": values})
        return values

    if first >= args.steps and not folder.is_dir():
        save(first)
    losses, number, start = [], first, time.perf_counter()
    with tqdm(total=args.steps, initial=first, desc="steps") as bar:
        while number < args.steps and not stop:
            number += 1
            state, loss = step(state, *_batch(texts, args.prompt_share, args.seed, number))
            losses.append(loss)
            bar.update()
            if number % args.evaluate_every == 0 or number == args.steps:
                mean, losses = float(np.mean(jax.device_get(losses))), []
                if not np.isfinite(mean):
                    raise FloatingPointError(f"the loss is not finite at step {number}: give another --seed")
                values, seconds = save(number), time.perf_counter() - start
                tqdm.write(f"step {number}: loss {mean:.3f}, {json.dumps(values)}, {seconds:.0f} s", file=sys.stderr)
                checkpoints.save(number, state, {})
    checkpoints.save(number, state, {}, wait=True)


def _first_params(config: ReaderConfig, start: Path | None, seed: int) -> Params:
    """The weights of the reader in ``start``, or fresh ones.

    Raises:
      ValueError: that reader has another size.
    """
    if start is None:
        return reader_network(config).init(jax.random.key(seed))
    reader = load_reader(start)
    if reader.config != config:
        raise ValueError(f"--start {start} is a reader of another size: begin with another")
    return jax.tree.map(lambda array: array.astype(jnp.float32), reader.params)


@functools.lru_cache(maxsize=1)
def _optimizer_and_step(config: ReaderConfig, steps: int) -> tuple[optax.GradientTransformation, Callable[..., Any]]:
    """The optimizer of a run of so many steps, and ``_step`` with it, compiled."""
    optimizer = adamw(
        learning_rate=1.5e-3,
        steps=steps,
        warmup=min(200, steps // 10),
        schedule="linear",
        weight_decay=1e-2,
        clip=1.0,
    )
    return optimizer, jax.jit(functools.partial(_step, config, optimizer))


def _step(config: ReaderConfig, optimizer: Any, state: Any, *batch: Any) -> Any:
    params, optimizer_state = state
    loss, gradients = jax.value_and_grad(lambda params: reader_loss(config, params, *batch))(params)
    updates, optimizer_state = optimizer.update(gradients, optimizer_state, params)
    return (optax.apply_updates(params, updates), optimizer_state), loss


def reader_loss(config: ReaderConfig, params: Params, features, numbers, mask, named, ends) -> jax.Array:
    """Sum over the attributes of the cross-entropies, mean over the texts."""
    losses = reader_losses(reader_network(config).apply(params, features, numbers, mask), named, ends)
    return losses.named.mean() + losses.ends.mean()


def _batch(texts: Texts, prompt_share: float, seed: int, number: int) -> tuple[np.ndarray, ...]:
    """Texts of similar length, drawn by the number of the step."""
    rng = np.random.default_rng((seed, number))
    number_of_prompts = round(4 * _BATCH * prompt_share)
    drawn = [("composed", 4 * _BATCH - number_of_prompts), ("prompts", number_of_prompts)]
    rows = np.concatenate([rng.choice(texts.trained[kind], size) for kind, size in drawn if size])
    rows = rows[np.argsort(np.diff(texts.starts)[rows])][rng.integers(4) * _BATCH :][:_BATCH]
    inputs = [texts.inputs(row) for row in rows]
    length = max(mask.shape[1] for _, _, mask in inputs)
    padded = [
        np.concatenate([np.pad(one, [(0, 0), (0, length - one.shape[1]), (0, 0)][: one.ndim]) for one in part])
        for part in zip(*inputs, strict=True)
    ]
    named, ends = (np.stack(part) for part in zip(*(texts.targets[row] for row in rows), strict=True))
    return *padded, named, ends


def _outputs(config: ReaderConfig, params: Params, texts: Texts, rows: np.ndarray) -> list[ReaderOutputs]:
    apply = jax.jit(reader_network(config).apply)
    return [jax.device_get(apply(params, *texts.inputs(row))) for row in rows]


def _evaluate(outputs: Sequence[ReaderOutputs], texts: Texts, rows: np.ndarray) -> dict[str, float]:
    """On texts that are not trained on: precision and recall of what is read, share of texts read in full."""
    readings = [read_outputs(one.named[0], one.ends[0]) for one in outputs]
    values = summarize(compare_readings([texts.requests[row] for row in rows], readings), len(rows))
    return {name: values[name] for name in ("precision", "recall", "full")}


if __name__ == "__main__":
    try:
        main()
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.train_reader: {error}")
