"""Driving episodes side by side in one jitted step, as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import UInt8

from scjax.scene.arguments import whole_number
from scjax.sim.behavior import BehaviorModel
from scjax.sim.gym.episodes import DrivingSource, EpisodeBatch
from scjax.sim.gym.rewards import Endings, RewardWeights
from scjax.sim.gym.slots import chosen_source, draw_moment, episode_seed, step_infos
from scjax.sim.gym.spaces import action_space, observation_space
from scjax.sim.simulate import TIME_STEP

_MAX_ENVS = 4096
Arrays = dict[str, np.ndarray]


class DrivingVectorEnv(VectorEnv):
    """``num_envs`` environments like ``DrivingEnv``, padded to one shape: one step of all is one program.

    Environment k with seed s + k gives what a ``DrivingEnv`` gives with that seed, up to rounding.

    Args:
      sources: scenes, maps or logs (at their first step), from which every episode of each environment draws.
      num_envs: N.
      seconds, actor, behavior, weights, endings, render_mode: as of ``DrivingEnv``.
      autoreset_mode: when an environment that has ended begins again: in the next step, whose action counts for
        nothing; in the same step, with ``final_obs`` and ``final_info`` in the info; or only by ``reset`` with the
        option ``reset_mask``.

    Raises:
      ValueError: as ``DrivingEnv``, or a number of environments that is not in 1..4096.
    """

    def __init__(
        self,
        sources: DrivingSource | Sequence[DrivingSource],
        num_envs: int,
        *,
        seconds: float = 15.0,
        actor: str | None = None,
        behavior: BehaviorModel | str | None = None,
        weights: RewardWeights | None = None,
        endings: Endings | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ):
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode is {render_mode!r}: give 'rgb_array' or None")
        self.render_mode = render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {
            "render_modes": ["rgb_array"],
            "render_fps": round(1 / TIME_STEP),
            "autoreset_mode": self.autoreset_mode,
        }
        self.num_envs = whole_number(num_envs, "num_envs", 1, _MAX_ENVS)
        self.weights = RewardWeights() if weights is None else weights
        self.endings = Endings() if endings is None else endings
        self.single_observation_space, self.single_action_space = observation_space(), action_space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._episodes = EpisodeBatch(sources, self.num_envs, seconds=seconds, actor=actor, behavior=behavior)
        self._generators = [np_random(None)[0] for _ in range(self.num_envs)]
        self._done = np.ones(self.num_envs, bool)
        self._runs = False

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Starts an episode in every environment.

        Args:
          seed: s, for seeds s, s + 1, ..., or one for each environment.
          options: ``source``, the row of a source for each environment [N] or for all; ``reset_mask``, which
            environments start [N].

        Raises:
          ValueError: another number of seeds, sources or flags than N, or no such source.
        """
        options = options or {}
        seeds = [None] * self.num_envs if seed is None else seed
        seeds = [seeds + k for k in range(self.num_envs)] if isinstance(seeds, int | np.integer) else list(seeds)
        sources = options.get("source")
        sources = [sources] * self.num_envs if sources is None or np.ndim(sources) == 0 else list(sources)
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, bool)))
        for name, values in (("seed", seeds), ("source", sources), ("reset_mask", mask)):
            if len(values) != self.num_envs:
                raise ValueError(f"{name} has {len(values)} values: give one for each of {self.num_envs} environments")
        if mask.dtype != np.bool_ or not (mask.any() and (mask.all() or self._runs)):
            raise ValueError("reset_mask must hold booleans, at least one True, and all True at first")
        for slot in np.flatnonzero(mask).tolist():
            own = seeds[slot]
            if own is not None:
                self._generators[slot] = np_random(int(own))[0]
        infos = self._begin(mask, sources)
        self._runs = True
        return self._episodes.observe(), infos

    def step(self, actions: Any) -> tuple[Arrays, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One step of 0.1 s of every environment.

        Raises:
          ValueError: actions of another shape than [N, 2].
        """
        if not self._runs:
            raise gymnasium.error.ResetNeeded("there are no episodes yet: call reset first")
        actions = np.asarray(actions, float)
        if actions.shape != (self.num_envs, 2):
            raise ValueError(f"actions have shape {actions.shape}: give shape ({self.num_envs}, 2)")
        next_step = self.autoreset_mode == AutoresetMode.NEXT_STEP
        begins = self._done if next_step else np.zeros(self.num_envs, bool)
        if not next_step and self._done.any():
            raise gymnasium.error.ResetNeeded("episodes have ended: reset them with the option reset_mask")
        terms = self._episodes.advance(actions, ~begins)
        ends = self.endings.terminated(terms) & ~begins
        late = (self._episodes.number >= self._episodes.steps) & ~ends & ~begins
        rewards = np.where(begins, 0.0, self.weights.reward(terms, TIME_STEP))
        infos = _masked(step_infos(terms), ~begins)
        self._done = ends | late
        if next_step and begins.any():
            infos |= self._begin(begins)
        observations = self._episodes.observe()
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._done.any():
            infos = self._final_infos(observations, step_infos(terms))
            infos |= self._begin(self._done.copy())
            observations = self._episodes.observe()
        return observations, rewards, ends, late, infos

    def render(self) -> tuple[UInt8[np.ndarray, "480 480 3"], ...] | None:
        """A picture of each environment, or None without a render mode."""
        if self.render_mode is None:
            return None
        if not self._runs:
            raise gymnasium.error.ResetNeeded("there are no episodes yet: call reset first")
        return tuple(draw_moment(self._episodes.log(slot)) for slot in range(self.num_envs))

    def _begin(self, mask: np.ndarray, choices: Sequence[Any] | None = None) -> dict[str, Any]:
        """Starts episodes where ``mask`` is True; what ``info`` says of them."""
        values = {name: np.zeros(self.num_envs, int) for name in ("source", "traffic_seed")}
        for slot in np.flatnonzero(mask).tolist():
            rng = self._generators[slot]
            choice = None if choices is None else choices[slot]
            seed = episode_seed(rng)
            source = chosen_source(rng, len(self._episodes.starts), choice)
            self._episodes.begin(slot, source, seed)
            values["source"][slot], values["traffic_seed"][slot] = source, seed
        self._done = self._done & ~mask
        return _masked(values, mask)

    def _final_infos(self, observations: Arrays, infos: Arrays) -> dict[str, Any]:
        """The infos of a step whose ended episodes begin again: theirs are in ``final_info``."""
        done, last = self._done, np.full(self.num_envs, None, object)
        for slot in np.flatnonzero(done).tolist():
            last[slot] = {name: values[slot].copy() for name, values in observations.items()}
        final = {"final_obs": last, "_final_obs": done.copy()}
        final |= {"final_info": _masked(infos, done), "_final_info": done.copy()}
        return _masked(infos, ~done) | final


def _masked(values: Arrays, mask: np.ndarray) -> Arrays:
    """Infos of a vector environment: zeros where they do not count, and beside each array which count."""
    if not mask.any():
        return {}
    kept = {name: np.where(mask, array, np.zeros((), array.dtype)) for name, array in values.items()}
    return kept | {f"_{name}": mask.copy() for name in values}
