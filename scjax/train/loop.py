"""The training loop: steps, reports, checkpoints and the exported model of one run."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from scjax.data.loader import BatchLoader, LoaderConfig, training_batches
from scjax.generate.model import save_model
from scjax.nn.functional import Params
from scjax.nn.sharding import host_copy
from scjax.train.checkpoint import Checkpoints
from scjax.train.objectives import make_objective
from scjax.train.objectives.base import Objective
from scjax.train.reporter import Reporter
from scjax.train.step import Metrics, TrainingStep, TrainState, initial_state, make_optimizer, make_param_groups


def train(config, workdir: Path) -> None:
    """Trains ``config.objective`` in ``workdir``, from its last checkpoint if there is one, to ``config.steps``.

    Raises:
      ValueError: an option or file that does not fit.
      FloatingPointError: the loss is not finite.
    """
    workdir.mkdir(parents=True, exist_ok=True)
    resolved = json.loads(config.to_json())
    if jax.process_index() == 0:
        (workdir / "config.json").write_text(json.dumps(resolved, indent=1))
    objective = make_objective(config)
    batches = training_batches(
        config.records,
        objective.codec,
        LoaderConfig.from_json(resolved["batch"]),
        texts=objective.texts,
        images=objective.images,
        process=jax.process_index(),
        processes=jax.process_count(),
    )
    with stop_signals() as stop, Checkpoints(workdir / "checkpoints", resolved) as checkpoints:
        run = TrainingRun(config, resolved, workdir, objective, batches, checkpoints)
        run.run_steps(stop)
        run.save(wait=True)
        if stop:
            print(f"stopped at step {run.number} of {config.steps}; the same command continues", file=sys.stderr)
            return
    folder = run.export("model")
    print(f"trained model: {folder}", file=sys.stderr)


class TrainingRun:
    """The state of a run, and what happens to it at some steps.

    Attributes:
      number: steps that are done.
      state: of the training after them.
    """

    def __init__(
        self,
        config,
        resolved: dict[str, Any],
        workdir: Path,
        objective: Objective,
        batches: BatchLoader,
        checkpoints: Checkpoints,
    ):
        self._config, self._resolved, self._workdir = config, resolved, workdir
        self._objective, self._batches, self._checkpoints = objective, batches, checkpoints
        params = objective.init(jax.random.fold_in(jax.random.key(config.seed), 0))
        if checkpoints.latest is None:
            params = objective.prepare(params)
        self._groups = make_param_groups(config.sharding, params, objective.frozen)
        optimizer = make_optimizer(config, self._groups)
        self._step = TrainingStep(
            objective.loss,
            self._groups,
            optimizer,
            ema_decay=config.ema_decay,
            seed=config.seed,
            batch_size=config.batch.batch_size,
        )
        self.number = 0
        self.state: TrainState = self._step.place(initial_state(params, self._groups, optimizer))
        if checkpoints.latest is not None:
            self.state, position = checkpoints.restore(self.state)
            batches.restore(position)
            self.number = checkpoints.latest
            print(f"continuing {workdir} at step {self.number}", file=sys.stderr)

    def run_steps(self, stop: list[int]) -> None:
        """Steps up to the last one, or until ``stop`` has an entry.

        The loss of a step is read while the next step runs.
        """
        config = self._config
        pending: tuple[int, Metrics] | None = None
        with Reporter(
            self._workdir,
            first_step=self.number,
            last_step=config.steps,
            tensorboard=config.tensorboard,
            quiet=jax.process_index() > 0,
        ) as reporter:
            start, scenes = time.perf_counter(), 0
            while self.number < config.steps and not stop:
                batch = next(self._batches)
                self.state, metrics = self._step(self.state, batch, np.asarray(batch.index))
                self.number += 1
                scenes += config.batch.batch_size
                if pending is not None:
                    self._check(*pending)
                pending = (self.number, metrics)
                reporter.advance()
                if self.number % config.log_every == 0 or self.number == config.steps:
                    values = jax.device_get(metrics)
                    rate = scenes / (time.perf_counter() - start)
                    reporter.scalars(self.number, {**values, "scenes_per_second": rate})
                self._after_step(metrics, reporter)
                if self.number % config.log_every == 0:
                    start, scenes = time.perf_counter(), 0
        if pending is not None:
            self._check(*pending)

    def save(self, *, wait: bool = False) -> None:
        """Writes a checkpoint in the background, or at once with ``wait``."""
        self._checkpoints.save(self.number, self.state, self._batches.state(), wait=wait)

    def export(self, name: str) -> Path:
        """Writes the model of this step as WORKDIR/name and returns the folder."""
        notes = {"steps": self.number, "config": self._resolved}
        model = self._objective.export(self._ema_params(), notes)
        folder = self._workdir / name
        return save_model(model, folder) if jax.process_index() == 0 else folder

    def _after_step(self, metrics: Metrics, reporter: Reporter) -> None:
        """What is due at this step: evaluation, pictures, a checkpoint, an exported model."""
        config, number = self._config, self.number
        if is_due(number, config.evaluate_every, config.steps):
            reporter.scalars(number, self._objective.evaluate(self._ema_params()), scope="val")
        if is_due(number, config.picture_every, config.steps):
            params = self._ema_params()
            if jax.process_index() == 0:
                self._objective.draw_pictures(params, lambda name: reporter.picture_path(number, name))
        if number % config.checkpoint_every == 0:
            self._check(number, metrics)
            self.save()
        if number in config.export_at:
            self.export(f"model-{number}")

    def _ema_params(self) -> Params:
        return self._groups.unpack(host_copy(self.state.ema))

    def _check(self, number: int, metrics: Metrics) -> None:
        """Stops the run at a loss that is not finite."""
        if not np.isfinite(float(metrics["loss"])):
            latest = self._checkpoints.latest
            raise FloatingPointError(
                f"the loss of step {number} is not finite; "
                + (f"the last good checkpoint is step {latest}" if latest is not None else "no checkpoint is before it")
                + ". Lower --config.optimizer.learning_rate, or look at the data of that step"
            )


def is_due(step: int, every: int, last: int) -> bool:
    """Every so many steps and at the end; 0 means never."""
    return every > 0 and (step % every == 0 or step == last)


@contextlib.contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Within it, SIGINT and SIGTERM only fill the list: the run ends after the step under way."""
    stop: list[int] = []
    handlers = {
        number: signal.signal(number, lambda received, _frame: stop.append(received))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
