"""How well drivers drive: one episode from each source and traffic seed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import numpy as np

from scjax.sim.gym import DrivingVectorEnv
from scjax.sim.gym.spaces import policy_actions
from scjax.sim.policies import RoutePolicy

Driver = Callable[[dict[str, np.ndarray]], np.ndarray]
"""Observations [N, ...] -> actions [N, 2]."""


@dataclasses.dataclass(frozen=True)
class Score:
    """Means over episodes: return, progress [m], and the shares with each ending or with a red light passed."""

    episodes: int
    reward: float
    progress: float
    collides: float
    off_road: float
    runs_red: float
    arrives: float


def score(env: DrivingVectorEnv, driver: Driver, seeds: range) -> Score:
    """The score of a driver: environment k drives source k, once for each traffic seed."""
    rounds = [_episodes(env, driver, 1000 * seed) for seed in seeds]
    sums = {name: np.concatenate([one[name] for one in rounds]) for name in rounds[0]}
    means = {name: float(values.mean()) for name, values in sums.items()}
    return Score(episodes=len(sums["reward"]), **means)


def _episodes(env: DrivingVectorEnv, driver: Driver, seed: int) -> dict[str, np.ndarray]:
    """The first episode of every environment; [N] of each field of ``Score``."""
    observation, _ = env.reset(seed=seed, options={"source": np.arange(env.num_envs)})
    names = ("collides", "off_road", "runs_red", "arrives")
    sums = {name: np.zeros(env.num_envs) for name in ("reward", "progress", *names)}
    runs = np.ones(env.num_envs, bool)
    while runs.any():
        observation, rewards, terminated, truncated, info = env.step(driver(observation))
        sums["reward"] += rewards * runs
        sums["progress"] += info["progress"] * runs
        for name in names:
            sums[name] = np.maximum(sums[name], info[name] & runs)
        runs &= ~(terminated | truncated)
    return sums


def baselines() -> dict[str, Driver]:
    """Drivers that learn nothing."""
    rng = np.random.default_rng(0)
    route = jax.jit(lambda boxes: policy_actions(RoutePolicy(), boxes))
    return {
        "RoutePolicy": lambda boxes: np.asarray(route(boxes)),
        "keeps speed, straight on": lambda boxes: np.zeros((len(boxes["speed"]), 2)),
        "random actions": lambda boxes: rng.uniform(-1.0, 1.0, (len(boxes["speed"]), 2)),
    }
