"""Rectified flow: the straight path, at which levels it is trained, and that training learns a distribution."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from scjax.diffusion.flow import flow_level, flow_schedule
from scjax.diffusion.loss import diffusion_loss
from scjax.diffusion.process import q_sample, target
from scjax.diffusion.samplers import Euler, Heun
from scjax.diffusion.samplers.loop import sample
from scjax.diffusion.schedule import cosine_schedule
from scjax.diffusion.timestep_sampling import TimestepSampling, draw_levels
from scjax.scene.per_type import PerType

SCHEDULE = cosine_schedule()


def pair(seed):
    keys = jax.random.split(jax.random.key(seed))
    return PerType(agents=jax.random.normal(keys[0], (3, 2, 4)), lanes=jax.random.normal(keys[1], (3, 5, 6)))


def test_the_path_is_straight_and_the_target_is_its_velocity():
    clean, noise = pair(0), pair(1)
    ends = [q_sample(flow_level(jnp.full(3, s)), clean, noise) for s in (0.0, 0.25, 1.0)]
    velocity = target(flow_level(jnp.full(3, 0.25)), clean, noise, "flow")
    np.testing.assert_array_equal(ends[0].lanes, clean.lanes)
    np.testing.assert_array_equal(ends[2].lanes, noise.lanes)
    np.testing.assert_allclose(ends[0].agents + 0.25 * velocity.agents, ends[1].agents, atol=1e-6)


def test_timesteps_lie_on_the_levels_between_them():
    levels = flow_schedule(100).levels
    between = flow_level(jnp.asarray(levels.noise))
    np.testing.assert_allclose(between.time, levels.time, atol=1e-4)
    assert levels.noise[-1] == 1 and levels.signal[-1] == 0 and levels.noise[0] == np.float32(0.01)
    np.testing.assert_allclose(flow_schedule(4).levels.noise, [0.25, 0.5, 0.75, 1.0])


@pytest.mark.parametrize("prediction", ["velocity", "flow"])
@pytest.mark.parametrize("draw", ["uniform", "logit-normal"])
def test_drawn_timesteps_have_the_levels_of_the_schedule(prediction, draw):
    level = draw_levels(jax.random.key(0), 4000, SCHEDULE, prediction, TimestepSampling(draw))
    expected = (SCHEDULE if prediction == "velocity" else flow_schedule(100)).levels[level.time]
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-6), level, expected)
    share = np.mean((np.asarray(level.time) >= 25) & (np.asarray(level.time) < 75))
    # The sigmoid of N(0, 1) lies in 0.25..0.75 where |x| < log 3.
    assert abs(share - (0.5 if draw == "uniform" else 0.728)) < 0.03
    assert set(np.asarray(level.time).tolist()) <= set(range(100))


def test_continuous_times_lie_between_the_timesteps():
    level = draw_levels(jax.random.key(0), 4000, SCHEDULE, "flow", TimestepSampling(continuous=True))
    s = np.asarray(level.noise)
    np.testing.assert_allclose(np.quantile(s, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.03)
    np.testing.assert_allclose(level.time, 100 * s - 1, rtol=1e-5)
    noisy = draw_levels(jax.random.key(0), 4000, SCHEDULE, "flow", TimestepSampling("logit-normal", True, mean=1.0))
    assert abs(np.median(noisy.noise) - 1 / (1 + np.exp(-1))) < 0.02
    with pytest.raises(ValueError, match="leave continuous times to flow"):
        draw_levels(jax.random.key(0), 4, SCHEDULE, "velocity", TimestepSampling(continuous=True))
    with pytest.raises(ValueError, match="uniform or logit-normal"):
        TimestepSampling("often")


def test_training_learns_two_modes():
    """Data +-1 with deviation 0.1, a network of one hidden layer, 500 steps: samples lie at the modes, evenly."""
    width, batch = 64, 256

    def network(params, z, t):
        s = (t[:, None, None] + 1.0) / 100

        def velocity(x):
            features = jnp.concatenate([x, jnp.broadcast_to(s, x.shape), jnp.square(jnp.broadcast_to(s, x.shape))], -1)
            return jnp.tanh(features @ params["in"] + params["bias"][None, None]) @ params["out"]

        return jax.tree.map(velocity, z)

    def data(key):
        signs, spread = jax.random.split(key)
        x = jax.random.rademacher(signs, (batch, 4, 1), jnp.float32) + 0.1 * jax.random.normal(spread, (batch, 4, 1))
        return PerType(agents=x[:, :2], lanes=x[:, 2:])

    mask = PerType(agents=jnp.ones((batch, 2), bool), lanes=jnp.ones((batch, 2), bool))
    nothing = jax.tree.map(jnp.zeros_like, mask)

    def loss(params, key):
        keys = jax.random.split(key, 3)
        level = draw_levels(keys[0], batch, SCHEDULE, "flow", TimestepSampling(continuous=True))
        args = level, data(keys[1]), data_noise(keys[2]), mask, nothing
        return diffusion_loss(lambda z, t: network(params, z, t), *args, prediction="flow")[0]

    def data_noise(key):
        x = jax.random.normal(key, (batch, 4, 1))
        return PerType(agents=x[:, :2], lanes=x[:, 2:])

    keys = jax.random.split(jax.random.key(0), 3)
    params = {
        "in": jax.random.normal(keys[0], (3, width)) * jnp.array([[2.0], [2.0], [2.0]]),
        "bias": jax.random.normal(keys[1], (width,)), "out": jnp.zeros((width, 1)),
    }  # fmt: skip
    optimizer = optax.adam(1e-2)

    @jax.jit
    def trained(params):
        def update(carry, step):
            params, state = carry
            gradient = jax.grad(loss)(params, jax.random.fold_in(keys[2], step))
            updates, state = optimizer.update(gradient, state)
            return (optax.apply_updates(params, updates), state), None

        return jax.lax.scan(update, (params, optimizer.init(params)), jnp.arange(500))[0][0]

    params = trained(params)
    for sampler, steps in ((Euler(), 50), (Heun(), 20)):
        found = jax.jit(
            lambda keys, s=sampler, n=steps: sample(
                lambda z, t: network(params, z, t), flow_schedule(n, last=s.last), keys, mask, sampler=s,
                widths=PerType(agents=1, lanes=1), most=PerType(agents=2, lanes=2), prediction="flow",
                temperature=PerType(agents=1.0, lanes=1.0),
            )
        )(jax.random.split(jax.random.key(1), batch))  # fmt: skip
        x = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(found)])
        near = np.mean(np.abs(np.abs(x) - 1) < 0.4)
        assert near > 0.85 and abs(np.mean(x > 0) - 0.5) < 0.08, (sampler, near)
