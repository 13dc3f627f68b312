"""All predictions give the same x0; a velocity tolerates errors that a noise prediction does not."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.flow import flow_level
from scjax.diffusion.loss import diffusion_loss
from scjax.diffusion.process import estimate_x0, prediction_target, q_sample
from scjax.diffusion.samplers.loop import sample_latents
from scjax.diffusion.schedule import cosine_schedule, respace
from scjax.scene.per_type import PerType

SCHEDULE = cosine_schedule()
LEVELS = {"noise": SCHEDULE.levels, "velocity": SCHEDULE.levels, "flow": flow_level(jnp.arange(1, 101) / 100)}


def _latents(seed, batch=100):
    keys = jax.random.split(jax.random.key(seed), 2)
    return PerType(agents=jax.random.normal(keys[0], (batch, 3, 4)), lanes=jax.random.normal(keys[1], (batch, 5, 6)))


@pytest.mark.parametrize("prediction", LEVELS)
def test_the_target_gives_back_x0(prediction):
    clean, noise, level = _latents(0), _latents(1), LEVELS[prediction][jnp.arange(100)]
    x = q_sample(level, clean, noise)
    x0 = estimate_x0(level, x, prediction_target(level, clean, noise, prediction), prediction)
    # At the last timestep alphas_cumprod is 2e-7: in float32 a noise prediction determines x0 only to 1e-3.
    tolerance = 2e-3 if prediction == "noise" else 1e-5
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=tolerance), x0, clean)


def test_small_errors_ruin_a_noise_prediction_only():
    clean, noise, errors = _latents(0), _latents(1), {}
    for prediction, levels in LEVELS.items():
        level = levels[jnp.full(100, 99)]
        output = jax.tree.map(lambda output: output + 0.01, prediction_target(level, clean, noise, prediction))
        x0 = estimate_x0(level, q_sample(level, clean, noise), output, prediction)
        errors[prediction] = float(jnp.abs(x0.lanes - clean.lanes).max())
    assert errors["velocity"] < 0.02 and errors["flow"] < 0.02 and errors["noise"] > 10


@pytest.mark.parametrize("steps", [100, 20])
def test_the_exact_velocity_leads_to_the_data(steps):
    schedule = respace(SCHEDULE, steps)
    clean = _latents(0, batch=4)
    alphas = jnp.asarray(SCHEDULE.alphas_cumprod)

    def denoise(x, t):
        a = alphas[t][:, None, None]  # noise and velocity follow from x0
        noise = jax.tree.map(lambda x, x0: (x - jnp.sqrt(a) * x0) / jnp.sqrt(1 - a), x, clean)
        return jax.tree.map(lambda e, x0: jnp.sqrt(a) * e - jnp.sqrt(1 - a) * x0, noise, clean)

    masks = PerType(agents=jnp.ones((4, 3), bool), lanes=jnp.ones((4, 5), bool))
    samples = jax.jit(
        lambda keys: sample_latents(
            denoise,
            schedule,
            keys,
            masks,
            latent_widths=PerType(agents=4, lanes=6),
            max_tokens=PerType(agents=3, lanes=5),
            prediction="velocity",
        )
    )(jax.random.split(jax.random.key(2), 4))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-3), samples, clean)


@pytest.fixture(scope="module")
def velocity_case():
    """(exact velocity, loss of a network output); lanes 0 and 1 are known."""
    clean, noise, level = _latents(0, batch=8), _latents(1, batch=8), SCHEDULE.levels[jnp.arange(8) * 12]
    masks = PerType(agents=jnp.ones((8, 3), bool), lanes=jnp.ones((8, 5), bool))
    known = PerType(agents=jnp.zeros((8, 3), bool), lanes=jnp.arange(5)[None] < jnp.full((8, 1), 2))

    def loss(output):
        return float(diffusion_loss(lambda z, t: output, level, clean, noise, masks, known, prediction="velocity")[0])

    return prediction_target(level, clean, noise, "velocity"), loss


def test_the_velocity_loss_is_zero_at_the_target(velocity_case):
    target, loss = velocity_case
    assert loss(target) == 0
    assert loss(target.replace(lanes=target.lanes.at[:, 2].add(1.0))) > 0.1


def test_known_tokens_do_not_count_in_the_velocity_loss(velocity_case):
    target, loss = velocity_case
    assert loss(target.replace(lanes=target.lanes.at[:, :2].set(7.0))) == 0
