"""Whatever a network predicts leads to the same x_0; why scjax's networks predict a velocity."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.flow import flow_level
from scjax.diffusion.loss import diffusion_loss
from scjax.diffusion.process import estimate_x0, q_sample, target
from scjax.diffusion.samplers.loop import sample
from scjax.diffusion.schedule import cosine_schedule, respaced
from scjax.scene.per_type import PerType

SCHEDULE = cosine_schedule()
LEVELS = {
    "noise": SCHEDULE.levels, "velocity": SCHEDULE.levels, "flow": flow_level(jnp.arange(1, 101) / 100)
}  # fmt: skip


def _pair(seed, batch=100):
    keys = jax.random.split(jax.random.key(seed), 2)
    return PerType(agents=jax.random.normal(keys[0], (batch, 3, 4)), lanes=jax.random.normal(keys[1], (batch, 5, 6)))


@pytest.mark.parametrize("prediction", LEVELS)
def test_the_target_gives_back_what_was_noised(prediction):
    clean, noise, level = _pair(0), _pair(1), LEVELS[prediction][jnp.arange(100)]
    x = q_sample(level, clean, noise)
    found = estimate_x0(level, x, target(level, clean, noise, prediction), prediction)
    # At the last time alphas_cumprod is 2e-7: in float32 the noise no longer holds x_0 to more than 1e-3.
    tolerance = 2e-3 if prediction == "noise" else 1e-5
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=tolerance), found, clean)


def test_an_error_of_a_hundredth_matters_little_in_the_velocity_and_ruins_the_noise():
    clean, noise, far = _pair(0), _pair(1), {}
    for prediction, levels in LEVELS.items():
        level = levels[jnp.full(100, 99)]
        off = jax.tree.map(lambda output: output + 0.01, target(level, clean, noise, prediction))
        found = estimate_x0(level, q_sample(level, clean, noise), off, prediction)
        far[prediction] = float(jnp.abs(found.lanes - clean.lanes).max())
    assert far["velocity"] < 0.02 and far["flow"] < 0.02 and far["noise"] > 10


@pytest.mark.parametrize("steps", [100, 20])
def test_a_network_that_knows_the_velocity_leads_to_the_data(steps):
    schedule = respaced(SCHEDULE, steps)
    clean = _pair(0, batch=4)
    alphas = jnp.asarray(SCHEDULE.alphas_cumprod)

    def denoise(x, t):
        a = alphas[t][:, None, None]  # x_0 is known: the noise follows, and from both the velocity
        noise = jax.tree.map(lambda x, x0: (x - jnp.sqrt(a) * x0) / jnp.sqrt(1 - a), x, clean)
        return jax.tree.map(lambda e, x0: jnp.sqrt(a) * e - jnp.sqrt(1 - a) * x0, noise, clean)

    masks = PerType(agents=jnp.ones((4, 3), bool), lanes=jnp.ones((4, 5), bool))
    generated = jax.jit(
        lambda keys: sample(
            denoise, schedule, keys, masks, widths=PerType(agents=4, lanes=6), most=PerType(agents=3, lanes=5),
            prediction="velocity",
        )
    )(jax.random.split(jax.random.key(2), 4))  # fmt: skip
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-3), generated, clean)


def test_the_velocity_loss_is_zero_at_the_target_and_given_tokens_do_not_count():
    clean, noise, level = _pair(0, batch=8), _pair(1, batch=8), SCHEDULE.levels[jnp.arange(8) * 12]
    masks = PerType(agents=jnp.ones((8, 3), bool), lanes=jnp.ones((8, 5), bool))
    known = PerType(agents=jnp.zeros((8, 3), bool), lanes=jnp.arange(5)[None] < jnp.full((8, 1), 2))
    wanted = target(level, clean, noise, "velocity")

    def loss(denoise):
        return diffusion_loss(denoise, level, clean, noise, masks, known, prediction="velocity")[0]

    assert float(loss(lambda x, t: wanted)) == 0
    spoilt = wanted.replace(lanes=wanted.lanes.at[:, :2].set(7.0))
    assert float(loss(lambda x, t: spoilt)) == 0
    assert float(loss(lambda x, t: wanted.replace(lanes=wanted.lanes.at[:, 2].add(1.0)))) > 0.1
