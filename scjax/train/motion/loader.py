"""Endless batches of moments of traffic with the next motions of some agents, for the training of behaviors."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from scjax.models.behavior.traffic import Traffic
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.train.motion.cache import MotionCache, limits_of

_STANDING = 0.25  # weight of agents that stand, in the choice of those that are trained
_BENDS = 4.0  # more weight for each rad/s of turning
_ATTEMPTS = 50


@pytree
class MotionExample(Replaceable):
    """A moment of traffic, or a batch of them; M agents of it are trained.

    Attributes:
      index: number of the example in the stream.
      traffic: N agents near each other.
      rows: of the trained agents.
      mask: which of them count.
      target: next motions.
      returns: bins of their returns.
    """

    index: Integer[AnyArray, "*b"]
    traffic: Traffic
    rows: Int[AnyArray, "*b M"]
    mask: Bool[AnyArray, "*b M"]
    target: Float[AnyArray, "*b M 3"]
    returns: Int[AnyArray, "*b M"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class MotionLoaderConfig:
    """What a stream of motion looks like.

    Attributes:
      batch_size: moments a batch, over all processes.
      agents: N, of a moment; those nearest to one of them.
      trained: M, agents of a moment that are trained.
      unknown_past: share of moments at which nobody's past is known, as at the start of a roll-out.
      seed: of everything random in the stream.
    """

    batch_size: int = 48
    agents: int = 64
    trained: int = 12
    unknown_past: float = 0.15
    seed: int = 0


class MotionLoader(Iterator[MotionExample]):
    """Endless batches; every example is a function of (seed, index). ``state`` and ``restore`` resume exactly.

    Args:
      files: of the cache, which all stay in memory.
      process, processes: a process gets the rows [process::processes] of every batch.

    Raises:
      ValueError: the batch size does not divide over the processes, or a file is damaged.
    """

    def __init__(
        self,
        cache: MotionCache,
        files: Sequence[str],
        config: MotionLoaderConfig,
        *,
        process: int = 0,
        processes: int = 1,
    ):
        if config.batch_size % processes:
            raise ValueError(f"batch_size {config.batch_size} does not divide over {processes} processes")
        self._rolls = [roll for roll in (cache.read(name) for name in files) if roll["trained"].any()]
        if not self._rolls:
            raise ValueError(f"{cache.folder} has no agent to train on: add logs")
        self._config, self._process, self._processes = config, process, processes
        self._next = 0

    def state(self) -> dict[str, Any]:
        """JSON-serializable state after the last batch."""
        return {"next": self._next}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues after the batch at which ``state`` was taken."""
        self._next = int(state["next"])

    def __next__(self) -> MotionExample:
        size = self._config.batch_size
        numbers = range(self._next + self._process, self._next + size, self._processes)
        self._next += size
        return batch_motion([self.example(number) for number in numbers])

    def example(self, index: int) -> MotionExample:
        """Example ``index`` of the stream."""
        config = self._config
        rng = np.random.default_rng([config.seed, index])
        for _ in range(_ATTEMPTS):
            roll = self._rolls[rng.integers(len(self._rolls))]
            step = int(rng.integers(len(roll["x"]) - 1))
            if roll["trained"][step].any():
                return _example(roll, step, index, config, rng)
        return _example(roll, int(roll["trained"].any(1).argmax()), index, config, rng)


def batch_motion(examples: Sequence[MotionExample]) -> MotionExample:
    """Examples as one batch."""
    return jax.tree.map(lambda *rows: np.stack(rows), *examples)


def _example(
    roll: dict[str, np.ndarray], step: int, index: int, config: MotionLoaderConfig, rng: np.random.Generator
) -> MotionExample:
    trained = roll["trained"][step]
    speed = np.abs(roll["target"][step, :, 0])
    weight = np.where(speed > 0.05, 1.0, _STANDING) + _BENDS * np.abs(roll["target"][step, :, 2])
    weight = np.where(trained, weight, 0.0)
    anchor = rng.choice(len(weight), p=weight / weight.sum())
    x, y = roll["x"][step], roll["y"][step]
    distance = np.where(roll["valid"][step], (x - x[anchor]) ** 2 + (y - y[anchor]) ** 2, np.inf)
    near = np.argsort(distance, kind="stable")[: config.agents]
    # Trained are near agents, since those at the edge do not see all of their neighbors.
    order = np.argsort(distance[near] * rng.exponential(size=len(near)) / np.maximum(weight[near], 1e-9), kind="stable")
    rows = order[: config.trained]
    mask = trained[near[rows]]
    traffic = _traffic(roll, step, near, config.agents)
    if rng.random() < config.unknown_past:
        fresh = _fill(roll["fresh"][step, near], config.agents)
        motions = np.broadcast_to(fresh[:, None], traffic.motions.shape).copy()
        traffic = traffic.replace(motions=motions, known=np.zeros_like(traffic.known))
    pad = config.trained - len(rows)
    return MotionExample(
        index=np.asarray(index, np.uint32),
        traffic=traffic,
        rows=np.pad(rows, (0, pad)).astype(np.int32),
        mask=np.pad(mask, (0, pad)),
        target=np.pad(roll["target"][step, near[rows]], ((0, pad), (0, 0))),
        returns=np.pad(roll["returns"][step, near[rows]].astype(np.int32), (0, pad)),
    )


def _fill(values: np.ndarray, size: int) -> np.ndarray:
    """The first axis padded with zeros to ``size``."""
    return np.concatenate([values, np.zeros((size - len(values), *values.shape[1:]), values.dtype)])


def _traffic(roll: dict[str, np.ndarray], step: int, rows: np.ndarray, size: int) -> Traffic:
    """Some agents at a step, around the first of them."""

    def get(name: str) -> np.ndarray:
        return roll[name][step, rows]

    x, y, heading = get("x"), get("y"), get("heading")
    x, y = x - x[0], y - y[0]
    ahead, left = get("way_ahead").astype(np.float32), get("way_left").astype(np.float32)
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    motions = get("motions").astype(np.float32)
    motions[:, 0] = get("base")
    fields = {
        "x": x, "y": y, "heading": heading, "length": roll["length"][rows], "width": roll["width"][rows],
        "kind": roll["kind"][rows].astype(np.int32), "valid": get("valid"), "motions": motions, "known": get("known"),
        "way_x": x[:, None] + ahead * cos - left * sin, "way_y": y[:, None] + ahead * sin + left * cos,
        "limit": limits_of(get("limit")), "inside": get("inside"), "has_way": get("has_way"),
        "signal": get("signal").astype(np.int32), "signal_gap": get("signal_gap").astype(np.float32),
        "end_gap": get("end_gap").astype(np.float32),
    }  # fmt: skip
    return Traffic(**{name: _fill(values, size) for name, values in fields.items()})
