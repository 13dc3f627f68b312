"""Trains one stage: python -m experiments.train --config=experiments/configs/<stage>.py:<variant> --workdir=runs/x

Stages: ``autoencoder``, then ``denoiser`` (which reads the first one's exported model), for prompts once more with
--config.condition=text and then ``counter``. Variants: tiny, small, base, official. Any field is changed on the command
line: --config.batch.batch_size=32. A run that is started again in the same --workdir continues at the very next batch;
Ctrl-C and SIGTERM save first. At the end, WORKDIR/model holds the trained model for scjax.load.
"""

from __future__ import annotations

if __name__ == "__main__":
    from scjax.train.malloc import keep_memory

    keep_memory()

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from absl import app, flags, logging
from ml_collections import config_flags

from scjax.data.loader import training_batches
from scjax.generate.model import save_model
from scjax.nn.startup import start_jax
from scjax.train.checkpoint import Checkpoints
from scjax.train.objectives import autoencoder as autoencoder_stage
from scjax.train.objectives import counts as counter_stage
from scjax.train.objectives import denoiser as denoiser_stage
from scjax.train.reporter import Reporter
from scjax.train.step import pipeline_config

_CONFIG = config_flags.DEFINE_config_file("config", None, "Config file and variant.", lock_config=True)
_WORKDIR = flags.DEFINE_string("workdir", None, "Folder of the run: checkpoints, metrics, pictures, the model.")
flags.mark_flags_as_required(["config", "workdir"])

STAGES = {"autoencoder": autoencoder_stage, "denoiser": denoiser_stage, "counter": counter_stage}


def main(_) -> None:
    # orbax reports every file that it touches, and logs with a traceback what it then raises.
    logging.set_verbosity(logging.FATAL)
    start_jax()
    try:
        train(_CONFIG.value, Path(_WORKDIR.value))
    except (ValueError, FloatingPointError, OSError) as error:
        # Writing to an open file fails without its name.
        where = f" (in {_WORKDIR.value})" if isinstance(error, OSError) and error.filename is None else ""
        print(f"experiments.train: {error}{where}", file=sys.stderr, flush=True)
        # The threads of a checkpoint that could not be written would print their traces after this line.
        os._exit(1)


def train(config, workdir: Path) -> None:
    """The whole run, top to bottom."""
    # --- the run's folder and its resolved config
    workdir.mkdir(parents=True, exist_ok=True)
    resolved = json.loads(config.to_json())
    (workdir / "config.json").write_text(json.dumps(resolved, indent=1))

    # --- data and stage: pure functions over a state
    stage = STAGES[config.stage].build(config)
    batches = training_batches(
        config.records, stage.codec, pipeline_config(resolved["batch"]), texts=stage.texts,
        images=stage.images, process=jax.process_index(), processes=jax.process_count(),
    )  # fmt: skip
    state = stage.init(jax.random.fold_in(jax.random.key(config.seed), 0))

    with stop_signals() as stop, Checkpoints(workdir / "checkpoints", resolved) as checkpoints:
        # --- resume
        step = 0
        if checkpoints.latest is None:
            state = stage.prepare(state)
        else:
            state, position = checkpoints.restore(state)
            batches.restore(position)
            step = checkpoints.latest
            print(f"continuing {workdir} at step {step}", file=sys.stderr)

        with Reporter(workdir, first_step=step, last_step=config.steps, tensorboard=config.tensorboard) as reporter:
            # --- the loop: metrics of a step are read while the next one runs
            pending: list[tuple[int, dict]] = []
            window, scenes = time.perf_counter(), 0
            while step < config.steps and not stop:
                batch = next(batches)
                state, metrics = stage.step(state, batch)
                step += 1
                scenes += config.batch.batch_size
                for earlier, values in pending:
                    _check(earlier, values, checkpoints)
                pending = [(step, metrics)]
                reporter.advance()

                if step % config.log_every == 0 or step == config.steps:
                    values = jax.device_get(metrics)
                    rate = scenes / (time.perf_counter() - window)
                    reporter.scalars(step, {**values, "scenes_per_second": rate})
                if due(step, config.evaluate_every, config.steps):
                    reporter.scalars(step, stage.evaluate(state), scope="val")
                if due(step, config.picture_every, config.steps):
                    stage.pictures(state, step, reporter)
                if step % config.checkpoint_every == 0:
                    _check(step, metrics, checkpoints)
                    checkpoints.save(step, state, batches.state())
                if step in config.export_at:
                    save_model(stage.export(state, resolved), workdir / f"model-{step}")
                if step % config.log_every == 0:
                    window, scenes = time.perf_counter(), 0

            # --- the end: a last checkpoint, and the model
            for earlier, values in pending:
                _check(earlier, values, checkpoints)
            checkpoints.save(step, state, batches.state(), wait=True)
            if stop:
                print(f"stopped at step {step} of {config.steps}; the same command continues", file=sys.stderr)
                return
        folder = save_model(stage.export(state, resolved), workdir / "model")
        print(f"trained model: {folder}", file=sys.stderr)


def due(step: int, every: int, last: int) -> bool:
    """Every so many steps and at the end; 0 means never."""
    return every > 0 and (step % every == 0 or step == last)


@contextlib.contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Within it, SIGINT and SIGTERM only fill the list: the run ends after the step under way."""
    stop: list[int] = []
    before = {
        number: signal.signal(number, lambda received, _frame: stop.append(received))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _check(step: int, metrics: dict, checkpoints: Checkpoints) -> None:
    """Stops the run at a non-finite loss."""
    if not np.isfinite(float(metrics["loss"])):
        good = checkpoints.latest
        raise FloatingPointError(
            f"the loss of step {step} is not finite; "
            + (f"the last good checkpoint is step {good}" if good is not None else "there is no checkpoint before it")
            + ". Lower --config.optimiser.learning_rate, or look at the data of that step"
        )


def parse(arguments: list[str]) -> list[str]:
    """Flags; a mistyped field is answered in one line, with the suggestion of ml_collections."""
    try:
        return app.parse_flags_with_usage(arguments)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        sys.exit(f"experiments.train: {error.args[0] if error.args else error}")


if __name__ == "__main__":
    app.run(main, flags_parser=parse)
