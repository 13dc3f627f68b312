"""One step over several devices is the step of the whole batch."""

import chex
import jax
import jax.numpy as jnp
import ml_collections
import numpy as np
import pytest

from scjax.train.flat_params import FlatParams
from scjax.train.optimizer import adamw
from scjax.train.step import initial, make_optimizer, training_step


def objective(params, batch, key):
    """A mean over the batch, without randomness, through which every row matters."""
    miss = jnp.tanh(batch @ params["kernel"]) - 1.0
    return jnp.square(miss).mean(), {"largest": jnp.abs(miss).max()}


def config(kind):
    return ml_collections.ConfigDict({"optimiser": {"kind": kind, "learning_rate": 1e-2, "warmup": 1}, "steps": 10})


def run(devices, steps=3, kind="adamw", **options):
    params = {"kernel": jnp.linspace(-1.0, 1.0, 6).reshape(3, 2)}
    packing = FlatParams.of(params)
    optimizer = make_optimizer(config(kind), packing)
    step = training_step(objective, packing, optimizer, ema_decay=0.9, seed=0, batch_size=4, devices=devices, **options)
    state = initial(params, packing, optimizer)
    batch = np.random.default_rng(0).normal(size=(4, 3)).astype(np.float32)
    for _ in range(steps):
        state, metrics = step(state, batch)
    return jax.device_get((state, metrics))


@pytest.mark.skipif(len(jax.devices()) < 2, reason="this machine shows JAX one device")
@pytest.mark.parametrize("kind", ["adamw", "muon"])
def test_devices_share_a_batch(kind):
    alone, metrics = run(jax.devices()[:1], kind=kind)
    shared, shared_metrics = run(jax.devices()[:2], kind=kind)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), alone, shared)
    assert alone.step == shared.step == 3
    for name in ("loss", "gradient_norm"):
        np.testing.assert_allclose(metrics[name], shared_metrics[name], rtol=1e-5)


def test_devices_that_do_not_divide_the_batch_are_left_out():
    """Three devices cannot share four scenes evenly: gcd(4, 3) = 1 works."""
    state, _ = run((jax.devices() * 3)[:3])
    alone, _ = run(jax.devices()[:1])
    jax.tree.map(np.testing.assert_array_equal, state, alone)


@pytest.mark.parametrize("at_once", [1, 2, 3])
def test_a_share_in_parts_is_the_same_step(at_once):
    whole, metrics = run(jax.devices()[:1])
    parts, parts_metrics = run(jax.devices()[:1], at_once=at_once)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), whole, parts)
    np.testing.assert_allclose(metrics["gradient_norm"], parts_metrics["gradient_norm"], rtol=1e-5)


def test_an_unknown_optimiser_is_named():
    with pytest.raises(ValueError, match='must be "adamw" or "muon", not \'adam\''):
        make_optimizer(config("adam"), FlatParams.of({"kernel": jnp.ones((3, 2))}))


def test_every_shape_of_a_batch_is_traced_once():
    """One program a bucket, however many steps are run."""
    optimizer = adamw(learning_rate=1e-2, steps=10, warmup=1)
    traced = chex.assert_max_traces(objective, n=2)
    params = {"kernel": jnp.ones((3, 2))}
    packing = FlatParams.of(params)
    step = training_step(traced, packing, optimizer, ema_decay=0.9, seed=0, batch_size=4, devices=jax.devices()[:1])
    state = initial(params, packing, optimizer)
    for rows in (4, 8, 4, 8, 4):
        state, _ = step(state, np.ones((rows, 3), np.float32))
    assert state.step == 5
