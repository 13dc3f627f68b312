"""Trains a reader of prompts on, together with the layers of its encoder, on written and composed prompts.

    nice -n 15 python -m experiments.tune_reader runs/tuned

Half of the written prompts of a batch are retyped. The same command continues where it was stopped (Ctrl-C and SIGTERM
save first). runs/tuned/model is the reader of the last evaluation: a running mean of the weights, calibrated on written
prompts that were held back.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from tqdm import tqdm

from experiments.reader_calibration import calibrate
from experiments.reader_encoder import encode_tokens, stacked_weights
from experiments.studies.page import script_parser
from experiments.studies.reading import compare_readings, summarize
from experiments.train_reader import reader_loss
from scjax.encoders.text import FrozenTextEncoder, clean_text
from scjax.generate.prompt_reader import PromptReader, load_reader, save_reader
from scjax.language.grammar.compose import Composition, compose_freely
from scjax.language.grammar.prompts import retype, written_prompts
from scjax.language.reader.numbers import token_numbers
from scjax.language.reader.targets import request_targets
from scjax.models.reader_network import ReaderOutputs
from scjax.nn.functional import Params
from scjax.scene.files import locked_folder
from scjax.train.checkpoint import Checkpoints, check_resume
from scjax.train.loop import stop_signals
from scjax.train.optimizer import adamw

SIZES = ((24, 24), (64, 12))
"""Tokens of the texts of a batch, and their number; longer texts are not trained on."""

_HELD_BACK_EVERY = 20  # of the written prompts, one is not trained on
_COMPOSED = 0.2  # share of a batch
_RETYPED = 0.5  # share of the written prompts
_NAMES = ("layers", "network")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = script_parser("experiments.tune_reader", __doc__)
    parser.add_argument("folder", type=Path, help="receives checkpoints and the model")
    parser.add_argument("--start", type=Path, help="folder of a reader to begin with (default: the one that ships)")
    parser.add_argument("--rate", type=float, default=1.5e-4, help="learning rate of the encoder, falls to 0")
    parser.add_argument("--network-rate", type=float, default=3e-4, help="that of the reader's network")
    parser.add_argument("--hide", type=float, default=0.05, help="share of tokens that are hidden, numbers never")
    parser.add_argument("--mean", type=float, default=0.99, help="share of the running mean that stays in a step")
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--evaluate-every", type=int, default=500)
    parser.add_argument("--seed", type=int, default=7)
    args = parser.parse_args(arguments)
    for name in ("hide", "mean"):
        if not 0 <= getattr(args, name) < 1:
            parser.error(f"--{name} is {getattr(args, name)}: give a share from 0 to below 1")
    if args.steps < 1 or args.evaluate_every < 1:
        parser.error("--steps and --evaluate-every must be 1 or more")
    reader = load_reader(args.start)
    run = {name: value for name, value in vars(args).items() if name not in ("folder", "start")}
    with locked_folder(args.folder):
        check_resume(args.folder / "checkpoints", run, {"encoder": reader.encoder_name})
        with (
            stop_signals() as stop,
            Checkpoints(args.folder / "checkpoints", run, {"encoder": reader.encoder_name}) as checkpoints,
        ):
            _tune(args.folder / "model", reader, args, checkpoints, stop)


class _Prompts(NamedTuple):
    """Written prompts: those that are trained on, in one list for each of ``SIZES``, and those that are held back."""

    trained: list[list[Composition]]
    held_back: Sequence[Composition]


def _tune(folder: Path, reader: PromptReader, args: Any, checkpoints: Checkpoints, stop: list[int]) -> None:
    prompts, encoder = _prompts(reader.encoder), reader.encoder
    weights = stacked_weights(encoder)
    params = {"layers": weights.pop("layers"), "network": jax.tree.map(jnp.float32, reader.params)}
    rates = {"layers": args.rate, "network": args.network_rate}
    warmup = min(30, args.steps // 10)
    parts = {
        name: adamw(learning_rate=rate, steps=args.steps, warmup=warmup, schedule="linear", weight_decay=1e-2, clip=1.0)
        for name, rate in rates.items()
    }
    optimizer = optax.partition(parts, {name: name for name in _NAMES})
    state, number = (params, params, optimizer.init(params)), checkpoints.latest or 0
    if number:
        state, _ = checkpoints.restore(state)

    def loss(params: Params, ids, kept, numbers, mask, named, ends) -> jax.Array:
        features = encode_tokens(encoder.config, {**weights, "layers": params["layers"]}, ids, mask)
        features = jnp.where(kept[..., None], features, 0.0)
        return reader_loss(reader.config, params["network"], features, numbers, mask, named, ends)

    @jax.jit
    def step(state: Any, number: Any, *batch: Any) -> Any:
        params, mean, optimizer_state = state
        value, gradients = jax.value_and_grad(loss)(params, *batch)
        updates, optimizer_state = optimizer.update(gradients, optimizer_state, params)
        params = optax.apply_updates(params, updates)
        share = jnp.minimum(args.mean, number / (number + 10.0))  # a shorter mean at first
        mean = jax.tree.map(lambda old, new: share * old + (1 - share) * new, mean, params)
        return (params, mean, optimizer_state), value

    losses = []
    with tqdm(total=args.steps, initial=number, desc="steps") as bar:
        while number < args.steps and not stop:
            number += 1
            state, value = step(state, float(number), *_batch(encoder, prompts.trained, args, number))
            losses.append(value)
            bar.update()
            if number % args.evaluate_every == 0 or number == args.steps:
                mean, losses = float(np.mean(jax.device_get(losses))), []
                if not np.isfinite(mean):
                    raise FloatingPointError(f"the loss is not finite at step {number}: give another --seed")
                values = _save(folder, reader, state[1], prompts.held_back, {"steps": number, "seed": args.seed})
                tqdm.write(f"step {number}: loss {mean:.3f}, {json.dumps(values)}", file=sys.stderr)
                checkpoints.save(number, state, {})
    checkpoints.save(number, state, {}, wait=True)


def _prompts(encoder: FrozenTextEncoder) -> _Prompts:
    trained: list[list[Composition]] = [[] for _ in SIZES]
    written = written_prompts()
    for row, prompt in enumerate(written):
        count = len(encoder.tokenizer.encode(clean_text(prompt.text)).ids)
        size = next((place for place, (length, _) in enumerate(SIZES) if count <= length), None)
        if row % _HELD_BACK_EVERY and size is not None:
            trained[size].append(prompt)
    return _Prompts(trained, written[::_HELD_BACK_EVERY])


def _batch(
    encoder: FrozenTextEncoder, trained: Sequence[Sequence[Composition]], args: Any, number: int
) -> tuple[np.ndarray, ...]:
    """Token ids, which are kept, numbers, mask and targets of texts of one length, drawn by the number of the step."""
    rng = np.random.default_rng((args.seed, number))
    batches = np.array([len(some) / size for some, (_, size) in zip(trained, SIZES, strict=True)])
    group = int(rng.choice(len(SIZES), p=batches / batches.sum()))
    length, size = SIZES[group]
    ids, numbers, mask = (np.zeros((size, length), kind) for kind in (np.int32, np.int32, bool))
    targets = []
    while len(targets) < size:
        if rng.random() < _COMPOSED:
            prompt = compose_freely(rng)
        else:
            prompt = trained[group][int(rng.integers(len(trained[group])))]
            prompt = retype(prompt, rng) if rng.random() < _RETYPED else prompt
        text = clean_text(prompt.text)
        encoded = encoder.tokenizer.encode(text)
        if (count := len(encoded.ids)) <= length:
            row = len(targets)
            ids[row, :count], numbers[row, :count] = encoded.ids, token_numbers(text, encoded.offsets)
            mask[row, :count] = True
            targets.append(request_targets(prompt.request))
    kept = (rng.random(mask.shape) >= args.hide) | (numbers > 0)
    named, ends = (np.stack(part) for part in zip(*targets, strict=True))
    return ids, kept, numbers, mask, named, ends


def _save(
    folder: Path, start: PromptReader, mean: Params, held_back: Sequence[Composition], notes: dict[str, Any]
) -> dict[str, float]:
    """Writes the reader, calibrated, and returns how well it reads."""
    count = len(start.encoder.params["layers"])
    layers = {row: jax.tree.map(lambda array, row=row: np.asarray(array[row]), mean["layers"]) for row in range(count)}
    reader = PromptReader(start.config, mean["network"], start.encoder_name, layers=layers)
    found = compare_readings([one.request for one in held_back], reader([one.text for one in held_back]))
    values = summarize(found, len(held_back))
    values = {name: values[name] for name in ("precision", "recall", "full")}
    outputs = jax.device_get([reader.outputs(clean_text(one.text)) for one in held_back])
    logits = ReaderOutputs(*(np.concatenate(some) for some in zip(*outputs, strict=True)))
    params = calibrate(reader.params, logits, [request_targets(one.request) for one in held_back])
    notes |= {"prompts": len(written_prompts()), "validation": values}
    save_reader(PromptReader(start.config, params, start.encoder_name, layers=layers), folder, notes)
    return values


if __name__ == "__main__":
    try:
        main()
    except (ValueError, OSError) as error:
        sys.exit(f"experiments.tune_reader: {error}")
