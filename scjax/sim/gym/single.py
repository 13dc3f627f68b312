"""One driving episode after the other, as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from jaxtyping import UInt8

from scjax.sim.behavior import BehaviorModel
from scjax.sim.gym.episodes import DrivingSource, EpisodeBatch
from scjax.sim.gym.rewards import Endings, RewardWeights
from scjax.sim.gym.slots import chosen_source, draw_moment, episode_seed, step_infos
from scjax.sim.gym.spaces import action_space, observation_space
from scjax.sim.simulate import TIME_STEP


class DrivingEnv(gymnasium.Env):
    """A policy drives one agent at 10 Hz among agents that a behavior model moves.

    Actions are acceleration and curvature in -1..1 (to 6 m/s^2 and 0.3 1/m). An action that is not finite brakes, and
    ``info["invalid_action"]`` says so. ``info`` holds the fields of ``DrivingTerms`` of each step. ``reset`` gives the
    row of the source and the seed of the traffic in ``info``; its option ``source`` chooses the source.

    Args:
      sources: scenes, maps or logs (at their first step). Each episode draws one of them.
      seconds: after which an episode is truncated.
      actor: id of the agent to drive in every source; the ego, or the first vehicle on a lane without one.
      behavior: of all others: a model or its name; ``RouteFollower()`` by default.
      weights: of the reward.
      endings: what terminates an episode.
      render_mode: "rgb_array" or None.

    Raises:
      ValueError: no source, a time of 0 s, another render mode, a source without a lane for cars, or an actor that
        follows no lane.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": round(1 / TIME_STEP)}

    def __init__(
        self,
        sources: DrivingSource | Sequence[DrivingSource],
        *,
        seconds: float = 15.0,
        actor: str | None = None,
        behavior: BehaviorModel | str | None = None,
        weights: RewardWeights | None = None,
        endings: Endings | None = None,
        render_mode: str | None = None,
    ):
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode is {render_mode!r}: give 'rgb_array' or None")
        self.render_mode = render_mode
        self.weights = RewardWeights() if weights is None else weights
        self.endings = Endings() if endings is None else endings
        self.observation_space, self.action_space = observation_space(), action_space()
        self._episodes = EpisodeBatch(sources, 1, seconds=seconds, actor=actor, behavior=behavior)
        self._runs = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Starts an episode. The same seed gives the same episode.

        Args:
          options: ``source``, the row of a source; drawn by default.

        Raises:
          ValueError: there is no such source.
        """
        super().reset(seed=seed)
        traffic_seed = episode_seed(self.np_random)
        source = chosen_source(self.np_random, len(self._episodes.starts), (options or {}).get("source"))
        self._episodes.begin(0, source, traffic_seed)
        self._runs = True
        return self._observation(), {"source": source, "traffic_seed": traffic_seed}

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """One step of 0.1 s.

        Raises:
          ValueError: an action of another shape than [2].
        """
        if not self._runs:
            raise gymnasium.error.ResetNeeded("there is no episode yet: call reset first")
        action = np.asarray(action, float)
        if action.shape != (2,):
            raise ValueError(f"action has shape {action.shape}: give acceleration and curvature, shape (2,)")
        terms = self._episodes.advance(action[None], np.ones(1, bool))
        terminated = bool(self.endings.terminated(terms)[0])
        truncated = bool(self._episodes.number[0] >= self._episodes.steps) and not terminated
        reward = float(self.weights.reward(terms, TIME_STEP)[0])
        infos = {name: values[0].item() for name, values in step_infos(terms).items()}
        return self._observation(), reward, terminated, truncated, infos

    def render(self) -> UInt8[np.ndarray, "480 480 3"] | None:
        """A picture of the surroundings of the driven agent from above, or None without a render mode."""
        if self.render_mode is None:
            return None
        if not self._runs:
            raise gymnasium.error.ResetNeeded("there is no episode yet: call reset first")
        return draw_moment(self._episodes.log(0))

    def _observation(self) -> dict[str, np.ndarray]:
        return {name: values[0] for name, values in self._episodes.observe().items()}
