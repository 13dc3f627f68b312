"""Rectified flow: the straight path, the noise levels of training, and training on a toy distribution."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from scjax.diffusion.flow import flow_level, flow_schedule
from scjax.diffusion.loss import diffusion_loss
from scjax.diffusion.process import prediction_target, q_sample
from scjax.diffusion.samplers import Euler, Heun
from scjax.diffusion.samplers.loop import sample_latents
from scjax.diffusion.schedule import cosine_schedule
from scjax.diffusion.timestep_sampling import TimestepSampling, sample_noise_levels
from scjax.scene.per_type import PerType

SCHEDULE = cosine_schedule()


def random_latents(seed):
    keys = jax.random.split(jax.random.key(seed))
    return PerType(agents=jax.random.normal(keys[0], (3, 2, 4)), lanes=jax.random.normal(keys[1], (3, 5, 6)))


def test_the_path_is_straight_and_the_target_is_its_velocity():
    clean, noise = random_latents(0), random_latents(1)
    start, quarter, end = (q_sample(flow_level(jnp.full(3, s)), clean, noise) for s in (0.0, 0.25, 1.0))
    velocity = prediction_target(flow_level(jnp.full(3, 0.25)), clean, noise, "flow")
    np.testing.assert_array_equal(start.lanes, clean.lanes)
    np.testing.assert_array_equal(end.lanes, noise.lanes)
    np.testing.assert_allclose(start.agents + 0.25 * velocity.agents, quarter.agents, atol=1e-6)


def test_timesteps_lie_on_the_continuous_levels():
    levels = flow_schedule(100).levels
    continuous = flow_level(jnp.asarray(levels.sigma))
    np.testing.assert_allclose(continuous.time, levels.time, atol=1e-4)
    assert levels.sigma[-1] == 1 and levels.alpha[-1] == 0 and levels.sigma[0] == np.float32(0.01)
    np.testing.assert_allclose(flow_schedule(4).levels.sigma, [0.25, 0.5, 0.75, 1.0])


@pytest.mark.parametrize("prediction", ["velocity", "flow"])
@pytest.mark.parametrize("distribution", ["uniform", "logit-normal"])
def test_sampled_timesteps_have_the_levels_of_the_schedule(prediction, distribution):
    level = sample_noise_levels(jax.random.key(0), 4000, SCHEDULE, prediction, TimestepSampling(distribution))
    expected = (SCHEDULE if prediction == "velocity" else flow_schedule(100)).levels[level.time]
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-6), level, expected)
    share = np.mean((np.asarray(level.time) >= 25) & (np.asarray(level.time) < 75))
    # The sigmoid of N(0, 1) lies in 0.25..0.75 where |x| < log 3.
    assert abs(share - (0.5 if distribution == "uniform" else 0.728)) < 0.03
    assert set(np.asarray(level.time).tolist()) <= set(range(100))


def test_continuous_levels_lie_between_the_timesteps():
    level = sample_noise_levels(jax.random.key(0), 4000, SCHEDULE, "flow", TimestepSampling(continuous=True))
    s = np.asarray(level.sigma)
    np.testing.assert_allclose(np.quantile(s, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.03)
    np.testing.assert_allclose(level.time, 100 * s - 1, rtol=1e-5)


def test_the_mean_shifts_the_logit_normal_distribution():
    sampling = TimestepSampling("logit-normal", continuous=True, mean=1.0)
    level = sample_noise_levels(jax.random.key(0), 4000, SCHEDULE, "flow", sampling)
    assert abs(np.median(level.sigma) - 1 / (1 + np.exp(-1))) < 0.02


def test_continuous_levels_need_a_flow():
    with pytest.raises(ValueError, match="leave continuous times to flow"):
        sample_noise_levels(jax.random.key(0), 4, SCHEDULE, "velocity", TimestepSampling(continuous=True))


def test_unknown_distributions_are_refused():
    with pytest.raises(ValueError, match="uniform or logit-normal"):
        TimestepSampling("often")


def toy_denoise(params, z, t):
    """A network of one hidden layer, applied to every latent."""
    s = (t[:, None, None] + 1.0) / 100

    def velocity(x):
        features = jnp.concatenate([x, jnp.broadcast_to(s, x.shape), jnp.square(jnp.broadcast_to(s, x.shape))], -1)
        return jnp.tanh(features @ params["in"] + params["bias"][None, None]) @ params["out"]

    return jax.tree.map(velocity, z)


def split_tokens(x):
    return PerType(agents=x[:, :2], lanes=x[:, 2:])


def test_training_learns_two_modes():
    """Data +-1 with standard deviation 0.1 and 500 steps: samples lie at both modes in equal shares."""
    width, batch = 64, 256
    masks = PerType(agents=jnp.ones((batch, 2), bool), lanes=jnp.ones((batch, 2), bool))
    nothing_known = jax.tree.map(jnp.zeros_like, masks)

    def data(key):
        signs, spread = jax.random.split(key)
        x = jax.random.rademacher(signs, (batch, 4, 1), jnp.float32)
        return split_tokens(x + 0.1 * jax.random.normal(spread, (batch, 4, 1)))

    def loss(params, key):
        keys = jax.random.split(key, 3)
        level = sample_noise_levels(keys[0], batch, SCHEDULE, "flow", TimestepSampling(continuous=True))
        noise = split_tokens(jax.random.normal(keys[2], (batch, 4, 1)))
        inputs = level, data(keys[1]), noise, masks, nothing_known
        return diffusion_loss(lambda z, t: toy_denoise(params, z, t), *inputs, prediction="flow")[0]

    keys = jax.random.split(jax.random.key(0), 3)
    params = {
        "in": jax.random.normal(keys[0], (3, width)) * jnp.array([[2.0], [2.0], [2.0]]),
        "bias": jax.random.normal(keys[1], (width,)),
        "out": jnp.zeros((width, 1)),
    }
    optimizer = optax.adam(1e-2)

    @jax.jit
    def train(params):
        def update(carry, step):
            params, state = carry
            gradient = jax.grad(loss)(params, jax.random.fold_in(keys[2], step))
            updates, state = optimizer.update(gradient, state)
            return (optax.apply_updates(params, updates), state), None

        return jax.lax.scan(update, (params, optimizer.init(params)), jnp.arange(500))[0][0]

    params = train(params)
    for sampler, steps in ((Euler(), 50), (Heun(), 20)):
        samples = jax.jit(
            lambda keys, sampler=sampler, steps=steps: sample_latents(
                lambda z, t: toy_denoise(params, z, t),
                flow_schedule(steps, last_step=sampler.last_step),
                keys,
                masks,
                sampler=sampler,
                latent_widths=PerType(agents=1, lanes=1),
                max_tokens=PerType(agents=2, lanes=2),
                prediction="flow",
                temperature=PerType(agents=1.0, lanes=1.0),
            )
        )(jax.random.split(jax.random.key(1), batch))
        x = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(samples)])
        share_at_modes = np.mean(np.abs(np.abs(x) - 1) < 0.4)
        assert share_at_modes > 0.85 and abs(np.mean(x > 0) - 0.5) < 0.08, (sampler, share_at_modes)
