"""Trains the reader of prompts on texts of the grammar and on written prompts, each with the request that it makes.

    nice -n 15 python -m experiments.train_reader runs/reader

Composes texts, encodes them once with the frozen multilingual encoder, and trains the network on them. Some tokens of a
text are hidden. The same command continues where it was stopped (Ctrl-C and SIGTERM save first). runs/reader/model is
the reader of the last evaluation: a running mean of the weights, and of those of --start (Wortsman et al. 2022),
calibrated on prompts that were held back.
"""

from __future__ import annotations

import dataclasses
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
from flax import nnx
from tqdm import tqdm

from experiments.reader_calibration import calibrate, reader_losses
from experiments.reader_texts import LENGTHS, Texts, reader_texts
from experiments.studies.page import script_parser
from experiments.studies.reading import compare_readings, summarize
from scjax.encoders.e5 import E5
from scjax.encoders.text import FrozenTextEncoder, load_text_encoder
from scjax.generate.prompt_reader import ENCODER_LAYERS, PromptReader, load_reader, reader_config, save_reader
from scjax.language.grammar.prompts import written_prompts
from scjax.language.reader.targets import read_outputs
from scjax.models.reader_network import Reader, ReaderConfig, ReaderOutputs, reader_network
from scjax.nn.functional import Functional, Params, flatten, functional, unflatten
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear
from scjax.scene.files import locked_folder
from scjax.train.checkpoint import Checkpoints, check_resume
from scjax.train.loop import stop_signals
from scjax.train.optimizer import adamw

_EVALUATED = 32  # texts at once


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.train_reader", __doc__)
    parser.add_argument("folder", type=Path, help="receives features, checkpoints and the model")
    parser.add_argument("--texts", type=int, default=48_000, help="texts of the grammar")
    parser.add_argument("--copies", type=int, default=3, help="of every written prompt, with other typing mistakes")
    parser.add_argument("--prompt-share", type=float, default=0.5, help="share of a batch that is written prompts")
    parser.add_argument("--start", type=Path, help="folder of a reader to begin with (default: fresh weights)")
    parser.add_argument(
        "--blocks", type=int, default=2, help="blocks of the network; those beyond --start's begin at 0"
    )
    parser.add_argument("--rate", type=float, default=1e-3, help="learning rate after the warm-up, falls to 0")
    parser.add_argument("--batch", type=int, default=32, help="texts in a step, fewer of long ones")
    parser.add_argument("--hide", type=float, default=0.05, help="share of tokens that are hidden, numbers never")
    parser.add_argument("--mean", type=float, default=0.998, help="share of the running mean that stays in a step")
    parser.add_argument(
        "--keep-start", type=float, default=0.2, help="share of the weights of --start in the reader that is saved"
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
    for name in ("hide", "mean", "keep_start"):
        if not 0 <= getattr(args, name) < 1:
            option = name.replace("_", "-")
            parser.error(f"--{option} is {getattr(args, name)}: give a share from 0 to below 1")
    if args.batch < 2:
        parser.error(f"--batch is {args.batch}: give 2 or more")
    encoder = load_text_encoder(E5, layers=ENCODER_LAYERS)
    with locked_folder(args.folder):
        texts, digest = reader_texts(
            args.folder / "features",
            encoder,
            composed=args.texts,
            copies=args.copies,
            held_back=args.held_back,
            seed=args.seed,
        )
        run = {name: value for name, value in vars(args).items() if name not in ("folder", "start", "keep_start")}
        check_resume(args.folder / "checkpoints", run, {"texts": digest})
        with stop_signals() as stop, Checkpoints(args.folder / "checkpoints", run, {"texts": digest}) as checkpoints:
            _train(args.folder / "model", encoder, texts, args, checkpoints, stop)


def _train(
    folder: Path, encoder: FrozenTextEncoder, texts: Texts, args: Any, checkpoints: Checkpoints, stop: list[int]
) -> None:
    config = reader_config(encoder.width, blocks=args.blocks)
    optimizer, step = _optimizer_and_step(config, args.steps, args.rate, args.mean)
    params = _first_params(config, args.start, args.seed)
    state, first = (params, params, optimizer.init(params)), checkpoints.latest or 0
    if first:
        state, _ = checkpoints.restore(state)
    kept = args.keep_start if args.start else 0.0

    def save(number: int) -> dict[str, Any]:
        """Writes the reader and returns how well it reads."""
        mean = jax.tree.map(lambda old, new: kept * old + (1 - kept) * new, params, state[1])
        outputs = {kind: _outputs(config, mean, texts, rows) for kind, rows in texts.held_back.items()}
        values = {kind: _evaluate(some, texts, texts.held_back[kind]) for kind, some in outputs.items()}
        mean = calibrate(mean, outputs["prompts"], [texts.targets[row] for row in texts.held_back["prompts"]])
        notes = {"texts": args.texts, "prompts": len(written_prompts()), "seed": args.seed, "steps": number}
        save_reader(PromptReader(config, mean, encoder.name), folder, {**notes, "validation": values})
        return values

    if first >= args.steps and not folder.is_dir():
        save(first)
    losses, number, start = [], first, time.perf_counter()
    with tqdm(total=args.steps, initial=first, desc="steps") as bar:
        while number < args.steps and not stop:
            number += 1
            state, loss = step(state, number, *_batch(texts, args, number))
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
    """The weights of the reader in ``start``, with more blocks that change nothing yet; or fresh ones.

    Raises:
      ValueError: that reader has another size.
    """
    fresh = reader_network(config).init(jax.random.key(seed))
    if start is None:
        return fresh
    reader = load_reader(start)
    if dataclasses.replace(reader.config, blocks=config.blocks) != config or reader.config.blocks > config.blocks:
        raise ValueError(f"--start {start} is a reader of another size: begin with another")
    known, params = flatten(reader.params), flatten(fresh)
    ends = ("near_out", "out", "down")  # of a block
    for path, array in params.items():
        params[path] = known[path].astype(jnp.float32) if path in known else array * (path[-2] not in ends)
    return unflatten(params)


@functools.lru_cache(maxsize=1)
def _optimizer_and_step(
    config: ReaderConfig, steps: int, rate: float, mean: float
) -> tuple[optax.GradientTransformation, Callable[..., Any]]:
    """The optimizer of a run of so many steps, and ``_step`` with it, compiled."""
    optimizer = adamw(
        learning_rate=rate,
        steps=steps,
        warmup=min(200, steps // 10),
        schedule="linear",
        weight_decay=1e-2,
        clip=1.0,
    )
    return optimizer, jax.jit(functools.partial(_step, config, optimizer, mean))


def _step(config: ReaderConfig, optimizer: Any, kept: float, state: Any, number: Any, *batch: Any) -> Any:
    params, mean, optimizer_state = state
    loss, gradients = jax.value_and_grad(lambda params: reader_loss(config, params, *batch))(params)
    updates, optimizer_state = optimizer.update(gradients, optimizer_state, params)
    params = optax.apply_updates(params, updates)
    share = jnp.minimum(kept, number / (number + 10.0))  # a shorter mean at first
    return (params, jax.tree.map(lambda old, new: share * old + (1 - share) * new, mean, params), optimizer_state), loss


def reader_loss(config: ReaderConfig, params: Params, features, numbers, mask, named, ends) -> jax.Array:
    """Sum over the attributes of the cross-entropies, mean over the texts."""
    losses = reader_losses(_training_network(config).apply(params, features, numbers, mask), named, ends)
    return losses.named.mean() + losses.ends.mean()


@functools.lru_cache(maxsize=1)
def _training_network(config: ReaderConfig) -> Functional:
    """The network with products of the operands that the processor multiplies fastest."""

    def build(init: ParamInit) -> Reader:
        reader = Reader(config, init=init)
        for _, module in nnx.iter_modules(reader):
            if isinstance(module, Linear):
                module.compute = "auto"
        return reader

    return functional(build)


def _batch(texts: Texts, args: Any, number: int) -> tuple[np.ndarray, ...]:
    """Texts of one length, drawn by the number of the step; every text is as likely as the others of its kind."""
    rng = np.random.default_rng((args.seed, number))
    share = {"composed": 1 - args.prompt_share, "prompts": args.prompt_share}
    parts = {kind: np.array([len(rows) for rows in groups], float) for kind, groups in texts.trained.items()}
    weights = {kind: share[kind] * part / max(part.sum(), 1) for kind, part in parts.items()}
    sizes = [max(1, args.batch * LENGTHS[0] // length) for length in LENGTHS]
    of_length = sum(weights.values())
    chances = of_length / sizes / (of_length / sizes).sum()
    group = int(rng.choice(len(LENGTHS), p=chances))
    of_prompts = rng.binomial(sizes[group], weights["prompts"][group] / of_length[group])
    drawn = {"prompts": of_prompts, "composed": sizes[group] - of_prompts}
    rows = np.concatenate([rng.choice(texts.trained[kind][group], size) for kind, size in drawn.items() if size])
    features, numbers, mask = texts.inputs(rows, LENGTHS[group])
    features[(rng.random(mask.shape) < args.hide) & (numbers == 0)] = 0
    named, ends = (np.stack(part) for part in zip(*(texts.targets[row] for row in rows), strict=True))
    return features, numbers, mask, named, ends


def _outputs(config: ReaderConfig, params: Params, texts: Texts, rows: np.ndarray) -> ReaderOutputs:
    """Of all rows, in their order."""
    apply = jax.jit(reader_network(config).apply)
    order = np.array(sorted(rows, key=lambda row: len(texts.numbers[row])))
    parts = []
    for start in range(0, len(order), _EVALUATED):
        part = order[start : start + _EVALUATED]
        full = np.resize(part, _EVALUATED)  # one compiled program for every length
        outputs = jax.device_get(apply(params, *texts.inputs(full)))
        parts.append(ReaderOutputs(*(np.asarray(one)[: len(part)] for one in outputs)))
    place = np.argsort(np.argsort([len(texts.numbers[row]) for row in rows], kind="stable"), kind="stable")
    return ReaderOutputs(*(np.concatenate(some)[place] for some in zip(*parts, strict=True)))


def _evaluate(outputs: ReaderOutputs, texts: Texts, rows: np.ndarray) -> dict[str, float]:
    """On texts that are not trained on: precision and recall of what is read, share of texts read in full."""
    numbers = [sorted({int(number) - 1 for number in texts.numbers[row] if number}) for row in rows]
    readings = [read_outputs(*one) for one in zip(outputs.named, outputs.ends, numbers, strict=True)]
    values = summarize(compare_readings([texts.requests[row] for row in rows], readings), len(rows))
    return {name: values[name] for name in ("precision", "recall", "full")}


if __name__ == "__main__":
    try:
        main()
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.train_reader: {error}")
