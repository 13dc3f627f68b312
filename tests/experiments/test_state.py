"""One step over several devices is the step of the whole batch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.state import initial, training_step
from scjax.diffusion.optimiser import adamw


def objective(params, batch, key):
    """A mean over the batch, without randomness, through which every row matters."""
    miss = jnp.tanh(batch @ params["kernel"]) - 1.0
    return jnp.square(miss).mean(), {"largest": jnp.abs(miss).max()}


def run(devices, steps=3):
    optimiser = adamw(learning_rate=1e-2, steps=10, warmup=1)
    step = training_step(objective, optimiser, ema_decay=0.9, seed=0, batch_size=4, devices=devices)
    state = initial({"kernel": jnp.linspace(-1.0, 1.0, 6).reshape(3, 2)}, optimiser)
    batch = np.random.default_rng(0).normal(size=(4, 3)).astype(np.float32)
    for _ in range(steps):
        state, metrics = step(state, batch)
    return jax.device_get((state, metrics))


@pytest.mark.skipif(len(jax.devices()) < 2, reason="this machine shows JAX one device")
def test_devices_share_a_batch():
    alone, metrics = run(jax.devices()[:1])
    shared, shared_metrics = run(jax.devices()[:2])
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), alone, shared)
    assert alone.step == shared.step == 3
    for name in ("loss", "gradient_norm"):
        np.testing.assert_allclose(metrics[name], shared_metrics[name], rtol=1e-5)


def test_devices_that_do_not_divide_the_batch_are_left_out():
    """Three devices cannot share four scenes evenly: gcd(4, 3) = 1 works."""
    state, _ = run((jax.devices() * 3)[:3])
    alone, _ = run(jax.devices()[:1])
    jax.tree.map(np.testing.assert_array_equal, state, alone)
