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

from scjax.nn.functional import Params
from scjax.nn.sharding import host_copy
from scjax.scene.files import locked_folder, remove_stale_parts, write_text
from scjax.train.batches import Batches, loader_config, open_batches, save_export
from scjax.train.checkpoint import Checkpoints, check_resume
from scjax.train.configs.schema import check_config
from scjax.train.objectives import make_objective
from scjax.train.objectives.base import Objective
from scjax.train.reporter import Reporter
from scjax.train.step import Metrics, TrainingStep, TrainState, initial_state, make_optimizer, make_param_groups


def train(config, workdir: Path, objective: Objective | None = None) -> None:
    """Trains ``config.objective`` in ``workdir``, from its last checkpoint if there is one, to ``config.steps``.

    Nothing is written before the config, the inputs and the last checkpoint are checked.

    Args:
      objective: made from ``config``, such as one with batches of its own; None: ``make_objective(config)``.

    Raises:
      ValueError: an option or file that does not fit, another run in ``workdir``, a damaged checkpoint, or another
        process that trains there.
      FloatingPointError: a loss or an update is not finite.
    """
    resolved = check_config(config)
    loader = loader_config(resolved)
    objective = make_objective(config) if objective is None else objective
    inputs, checkpoints_folder = objective.inputs, workdir / "checkpoints"
    check_resume(checkpoints_folder, resolved, inputs)
    if workdir.exists() and not workdir.is_dir():
        raise ValueError(f"{workdir} is no folder: choose another --workdir")
    is_first = jax.process_index() == 0
    with stop_signals() as stop, locked_folder(workdir) if is_first else contextlib.nullcontext():
        if is_first:
            remove_stale_parts(workdir)
            remove_stale_parts(workdir / "pictures")
        batches = open_batches(objective, resolved.get("records", ""), loader)
        with Checkpoints(checkpoints_folder, resolved, inputs) as checkpoints:
            run = TrainingRun(config, resolved, workdir, objective, batches, checkpoints)
            if is_first:
                write_text(workdir / "config.json", json.dumps(resolved, indent=1))
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
        batches: Batches,
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
            checkpoints.use_position(batches.restore, position)
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
            self._export_if_due(again=False)
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
        return save_export(model, folder) if jax.process_index() == 0 else folder

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
            self._check(number, metrics)
        self._export_if_due(again=True)

    def _export_if_due(self, *, again: bool) -> None:
        """Exports the model of this step if ``config.export_at`` has it; an existing one is replaced with ``again``.

        A process may have been killed between the checkpoint and the model of a step.
        """
        name = f"model-{self.number}"
        if self.number in self._config.export_at and (again or not (self._workdir / name).exists()):
            self.export(name)

    def _ema_params(self) -> Params:
        return self._groups.unpack(host_copy(self.state.ema))

    def _check(self, number: int, metrics: Metrics) -> None:
        """Stops the run at a loss or an update that is not finite, before either can reach a file.

        The update has a finite norm only if all its numbers, and so the parameters after it, are finite.
        """
        for name, text in (("loss", "loss"), ("gradient_norm", "gradient"), ("update_norm", "update")):
            if not np.isfinite(float(metrics[name])):
                raise FloatingPointError(f"the {text} of step {number} is not finite; {self._way_on()}")

    def _way_on(self) -> str:
        latest = self._checkpoints.latest
        if latest is None:
            return (
                "no checkpoint is before it. Lower --config.optimizer.learning_rate, or look at the data of that step"
            )
        return (
            f"the last good checkpoint is step {latest}, from which the same command continues. If it fails again, "
            f"look at the data of that step, or give --config.export_at=({latest},) for the model of that checkpoint, "
            "and start another --workdir from it with --config.init_from and a lower --config.optimizer.learning_rate"
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
