"""Traffic from a moment: a scene, map or log -> a log of what happens next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, overload

import jax
import numpy as np
from jaxtyping import Int

from scjax.generate.arguments import sampling_key
from scjax.scene import NO_EGO, Log, Map, Scene
from scjax.scene.arguments import finite_number
from scjax.sim.behavior import BehaviorModel
from scjax.sim.behaviors import as_behavior
from scjax.sim.preparation import Start, pad_start, prepare
from scjax.sim.rollout import roll_out, stack_records
from scjax.sim.track_log import TrackLog

TIME_STEP = 0.1  # s
MAX_SECONDS = 600.0
_MAX_BATCH = 16  # scenes in one call
_COMPILING = 10e6  # us that a further program takes to compile
_SIGNAL_STEP = 64  # signals are padded to multiples


@overload
def simulate(
    key: Any,
    source: Log | Map | Scene,
    *,
    seconds: float = 15.0,
    behavior: BehaviorModel | str | None = None,
    step: int = 0,
) -> Log: ...
@overload
def simulate(
    key: Any,
    source: Sequence[Log | Map | Scene],
    *,
    seconds: float = 15.0,
    behavior: BehaviorModel | str | None = None,
    step: int = 0,
) -> list[Log]: ...
def simulate(key, source, *, seconds=15.0, behavior=None, step=0):
    """What happens in the ``seconds`` after a moment, at 10 Hz.

    Step 0 of the log is the moment itself. Vehicles that leave the map become invalid, and such that enter it are new
    objects. Signals run through phases that begin with what they show; signals whose state is not known stay so.

    Args:
      key: a key of ``jax.random``, or a number. The same key gives the same log, alone or in a list.
      source: a scene, a map, a log, or a list of them, which is simulated together and faster.
      behavior: how agents move: a model, or one of the names in ``BEHAVIORS``; ``RouteFollower()`` by default.
      step: of a log, from which on it is simulated.

    Returns:
      A log, or a list for a list. Objects keep their ids; the ego stays the ego.

    Raises:
      ValueError: a time of 0 s, no lane that cars may use, too many agents, or no such step.
    """
    seconds = finite_number(seconds, "seconds", TIME_STEP, MAX_SECONDS)
    steps = round(seconds / TIME_STEP)
    sources = list(source) if isinstance(source, Sequence) else [source]
    behavior = as_behavior(behavior)
    key = sampling_key(key)
    starts = [prepare(one, step, np.random.default_rng(key_seed(key))) for one in sources]
    logs: dict[int, Log] = {}
    for rows in _alike([start.shape for start in starts], steps):
        shape = tuple(max(sizes) for sizes in zip(*(starts[row].shape for row in rows), strict=True))
        batch = min(_MAX_BATCH, 1 << (len(rows) - 1).bit_length())
        for begin in range(0, len(rows), batch):
            chunk = rows[begin : begin + batch]
            found = _run([pad_start(starts[row], shape) for row in chunk], key, behavior, steps, batch)
            logs.update(zip(chunk, found, strict=True))
    result = [logs[row] for row in range(len(sources))]
    return result if isinstance(source, Sequence) else result[0]


def _alike(shapes: Sequence[tuple[int, ...]], steps: int) -> list[list[int]]:
    """Rows of scenes that are padded to one shape: a smaller one comes only where it saves more than it takes to
    compile.
    """
    costs = np.array([_step_cost(shape) for shape in shapes])
    groups: list[list[int]] = []
    rows = np.argsort(-costs, kind="stable")
    for place, row in enumerate(rows.tolist()):
        if not groups or steps * (costs[groups[-1][0]] - costs[rows[place:]]).sum() > _COMPILING:
            groups.append([])
        groups[-1].append(row)
    return groups


def _step_cost(shape: tuple[int, ...]) -> float:
    """About how long a core takes for one step of a scene [us], as benchmarks/README.md has it."""
    agents, _, _, conflicts = shape
    return 100 + 3.5 * agents + 0.07 * agents * agents + 0.11 * conflicts


def key_seed(key: Any) -> np.ndarray:
    """Numbers of a key, to seed a generator of NumPy."""
    return np.asarray(jax.random.key_data(key)).astype(np.uint32)


def padded_signals(starts: Sequence[Start], steps: int, clock: float = 0.0) -> Int[np.ndarray, "B T S"]:
    """``Signal`` of all signals at the start of every step from ``clock`` [s] on, padded."""
    times = clock + np.arange(steps) * TIME_STEP
    width = -(-max(1, *(len(start.plan.cycle) for start in starts)) // _SIGNAL_STEP) * _SIGNAL_STEP
    signals = np.zeros((len(starts), steps, width), np.int32)
    for row, start in enumerate(starts):
        signals[row, :, : len(start.plan.cycle)] = start.plan.states(times).T
    return signals


def _run(starts: list[Start], key: Any, behavior: BehaviorModel, steps: int, batch: int) -> list[Log]:
    """The logs of at most ``batch`` scenes of one shape."""
    signals = padded_signals(starts, steps)
    rows = np.minimum(np.arange(batch), len(starts) - 1)
    networks, agents, places = (
        stack_records([getattr(starts[row], name) for row in rows]) for name in ("network", "agents", "places")
    )
    batch_keys = jax.numpy.stack([key] * len(rows))
    after = roll_out(batch_keys, networks, agents, places, signals[rows], behavior=behavior, dt=TIME_STEP)
    after = {name: np.asarray(values) for name, values in after.items()}
    return [_log_of(start, {k: v[row] for k, v in after.items()}) for row, start in enumerate(starts)]


def _log_of(start: Start, after: dict[str, np.ndarray]) -> Log:
    track, log = TrackLog(start), start.log
    track.add(start, after, start.plan.states((1 + np.arange(len(after["x"]))) * TIME_STEP))
    return track.log(log, None if log.ego_index == NO_EGO else log.object_ids[log.ego_index], TIME_STEP)
