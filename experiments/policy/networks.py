"""Policy and value network, and PPO of skrl, for the observations of ``scjax.sim.gym``."""

from __future__ import annotations

from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from gymnasium.vector import VectorEnv
from skrl.agents.jax.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.jax import Wrapper, wrap_env
from skrl.memories.jax import RandomMemory
from skrl.models.jax import DeterministicMixin, GaussianMixin, Model
from skrl.utils.spaces.jax import unflatten_tensorized_space

ROLLOUT = 64  # steps between two updates
_FIRST_STD = (0.3, 0.06)  # of acceleration and curvature, in the units of the action space
_CURVATURE = 0.3  # of the network's output: large curvatures are rare
_NUM_TYPES = 4


class Features(nn.Module):
    """What both networks read: speed, place on the route, its points, the next red light, and agents as a set."""

    width: int = 128

    @nn.compact
    def __call__(self, boxes: dict[str, jax.Array]) -> jax.Array:
        route_mask = boxes["route_mask"][..., None].astype(jnp.float32)
        route = boxes["route"] / jnp.array([40.0, 20.0, 15.0])
        mask = boxes["agent_mask"][..., None].astype(jnp.float32)
        types = jax.nn.one_hot(boxes["agent_types"].astype(jnp.int32), _NUM_TYPES)
        agents = boxes["agents"] / jnp.array([20.0, 10.0, 1.0, 1.0, 10.0, 5.0, 2.0])
        near = jnp.exp(-jnp.linalg.norm(boxes["agents"][..., :2], axis=-1, keepdims=True) / 15.0)
        agents = jnp.concatenate([jnp.clip(agents, -5.0, 5.0), types, near], -1)
        agents = nn.Dense(64)(nn.relu(nn.Dense(64)(agents)))
        crowd = jnp.where(mask > 0, agents, -10.0).max(-2)
        ego = jnp.concatenate(
            [
                boxes["speed"] / 10.0,
                boxes["size"] / 5.0,
                jnp.clip(boxes["lateral"], -5.0, 5.0) / 2.0,
                boxes["heading"] * 2.0,
                jnp.exp(-boxes["stop_distance"] / 15.0),
                (route * route_mask).reshape(*route.shape[:-2], -1),
                route_mask[..., 0],
                nn.relu(crowd),
            ],
            -1,
        )
        return nn.tanh(nn.Dense(self.width)(nn.tanh(nn.Dense(self.width)(ego))))


class DrivingPolicy(GaussianMixin, Model):
    """Mean acceleration and curvature; the standard deviations are parameters."""

    def __init__(self, observation_space, action_space, device, **options):
        spaces = {"observation_space": observation_space, "action_space": action_space}
        Model.__init__(self, **spaces, device=device, **options)
        GaussianMixin.__init__(self, clip_log_std=True, min_log_std=-5.0, max_log_std=0.0)

    @nn.compact
    def __call__(self, inputs: dict[str, Any], role: str):
        boxes = unflatten_tensorized_space(self.observation_space, inputs["observations"])
        out = nn.Dense(2, kernel_init=nn.initializers.orthogonal(0.01))(Features()(boxes))
        log_std = self.param("log_std", lambda _: jnp.log(jnp.array(_FIRST_STD)))
        return jnp.tanh(out) * jnp.array([1.0, _CURVATURE]), {"log_std": log_std}


class DrivingValue(DeterministicMixin, Model):
    """The return that a state promises."""

    def __init__(self, observation_space, action_space, device, **options):
        spaces = {"observation_space": observation_space, "action_space": action_space}
        Model.__init__(self, **spaces, device=device, **options)
        DeterministicMixin.__init__(self)

    @nn.compact
    def __call__(self, inputs: dict[str, Any], role: str):
        boxes = unflatten_tensorized_space(self.observation_space, inputs["observations"])
        return nn.Dense(1)(Features()(boxes)), {}


class DrivingPPO(PPO):
    """PPO for which an episode that ran out of time has ended too: its advantages stop there.

    The return beyond is that which the value network expects (``time_limit_bootstrap``).
    """

    def record_transition(self, *, terminated: jax.Array, truncated: jax.Array, **transition: Any) -> None:
        """See ``PPO``."""
        ends = jnp.maximum(jnp.asarray(terminated), jnp.asarray(truncated))
        super().record_transition(terminated=ends, truncated=truncated, **transition)


def make_agent(env: VectorEnv) -> tuple[DrivingPPO, Wrapper]:
    """The agent with new networks, and the environments as skrl takes them."""
    wrapped = wrap_env(env)
    device = wrapped.device
    models = {
        "policy": DrivingPolicy(wrapped.observation_space, wrapped.action_space, device),
        "value": DrivingValue(wrapped.observation_space, wrapped.action_space, device),
    }
    for role, model in models.items():
        model.init_state_dict(role=role)
    config = PPO_CFG()
    config.rollouts = ROLLOUT
    config.learning_epochs = 5
    config.mini_batches = 4
    config.discount_factor = 0.98
    config.gae_lambda = 0.95
    config.learning_rate = 5e-4
    config.entropy_loss_scale = 0.0
    config.value_loss_scale = 1.0
    config.time_limit_bootstrap = True
    config.experiment.write_interval = 0
    config.experiment.checkpoint_interval = 0
    agent = DrivingPPO(
        models=models,
        memory=RandomMemory(memory_size=ROLLOUT, num_envs=wrapped.num_envs, device=device),
        observation_space=wrapped.observation_space,
        action_space=wrapped.action_space,
        device=device,
        cfg=config,
    )
    return agent, wrapped
