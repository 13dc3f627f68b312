"""A training step does not depend on the devices, on parts, or on how the state is sharded."""

from __future__ import annotations

import chex
import jax
import jax.numpy as jnp
import ml_collections
import numpy as np
import pytest

from scjax.nn import random
from scjax.train.optimizer import adamw
from scjax.train.step import TrainingStep, initial_state, make_optimizer, make_param_groups

PARAMS = {"layer": {"kernel": jnp.linspace(-1.0, 1.0, 8).reshape(4, 2), "bias": jnp.zeros(2)}, "scale": jnp.ones(())}
INDEX = np.asarray([7, 2, 30, 11], np.uint32)
two_devices = pytest.mark.skipif(len(jax.devices()) < 2, reason="this machine shows JAX one device")


def noisy_loss(params, batch, keys):
    """A mean over scenes to which every row and its own noise matter."""
    noise = random.normal(keys, (len(batch), 2))
    layer = params["layer"]
    error = jnp.tanh(batch @ layer["kernel"] + layer["bias"][None]) * params["scale"] - noise
    return jnp.square(error).mean(), {"error": jnp.abs(error).mean()}


def make_config(kind):
    options = {"kind": kind, "learning_rate": 1e-2, "warmup": 1}
    return ml_collections.ConfigDict({"optimizer": options, "steps": 10})


def run_steps(devices, *, kind="adamw", sharding="flat", frozen=frozenset(), **options):
    """Parameters, their average and the metrics after three steps."""
    groups = make_param_groups(sharding, PARAMS, frozen)
    optimizer = make_optimizer(make_config(kind), groups)
    step = TrainingStep(noisy_loss, groups, optimizer, ema_decay=0.9, seed=0, batch_size=4, devices=devices, **options)
    state = initial_state(PARAMS, groups, optimizer)
    batch = np.random.default_rng(0).normal(size=(4, 4)).astype(np.float32)
    metrics = {}
    for number in range(3):
        state, metrics = step(state, batch, INDEX + 40 * number)
    state, metrics = jax.device_get((state, metrics))
    assert state.step == 3
    return groups.unpack(state.params), groups.unpack(state.ema), metrics


@two_devices
@pytest.mark.parametrize("sharding", ["flat", "fsdp"])
@pytest.mark.parametrize("kind", ["adamw", "muon"])
def test_step_is_the_same_on_two_devices(kind, sharding):
    one = run_steps(jax.devices()[:1], kind=kind, sharding=sharding)
    two = run_steps(jax.devices()[:2], kind=kind, sharding=sharding)
    chex.assert_trees_all_close(one, two, rtol=1e-5, atol=1e-7)


@two_devices
@pytest.mark.parametrize("frozen", [frozenset(), frozenset({("layer", "bias")})])
def test_fsdp_step_is_the_flat_step(frozen):
    flat = run_steps(jax.devices()[:2], sharding="flat", frozen=frozen)
    fsdp = run_steps(jax.devices()[:2], sharding="fsdp", frozen=frozen)
    chex.assert_trees_all_close(flat, fsdp, rtol=1e-5, atol=1e-7)
    assert np.array_equal(fsdp[0]["layer"]["bias"], PARAMS["layer"]["bias"]) == bool(frozen)


@two_devices
def test_fsdp_state_is_sharded_by_rule():
    groups = make_param_groups("fsdp", PARAMS)
    optimizer = make_optimizer(make_config("adamw"), groups)
    step = TrainingStep(noisy_loss, groups, optimizer, ema_decay=0.9, seed=0, batch_size=4, devices=jax.devices()[:2])
    state = step.place(initial_state(PARAMS, groups, optimizer))
    state, _ = step(state, np.ones((4, 4), np.float32), INDEX)
    kernel, bias = state.params["kernel"]["layer.kernel"], state.params["rest"]["layer.bias"]
    assert kernel.addressable_shards[0].data.shape == (2, 2)
    assert bias.is_fully_replicated


def test_step_leaves_out_devices_that_do_not_divide_the_batch():
    """Three devices cannot share four scenes evenly; one can."""
    chex.assert_trees_all_equal(run_steps((jax.devices() * 3)[:3]), run_steps(jax.devices()[:1]))


@pytest.mark.parametrize("sharding", ["flat", "fsdp"])
@pytest.mark.parametrize("at_once", [1, 2, 3])
def test_step_in_parts_is_the_whole_step(at_once, sharding):
    whole = run_steps(jax.devices()[:1])
    parts = run_steps(jax.devices()[:1], at_once=at_once, sharding=sharding)
    chex.assert_trees_all_close(whole, parts, rtol=1e-5, atol=1e-7)


def test_make_optimizer_names_the_known_kinds():
    with pytest.raises(ValueError, match='must be "adamw" or "muon", not \'adam\''):
        make_optimizer(make_config("adam"), make_param_groups("flat", PARAMS))


def test_make_param_groups_names_the_known_shardings():
    with pytest.raises(ValueError, match='must be "flat" or "fsdp", not \'zero\''):
        make_param_groups("zero", PARAMS)


def test_step_traces_each_batch_shape_once():
    """One program per bucket, for any number of steps."""
    traced = chex.assert_max_traces(noisy_loss, n=2)
    groups, optimizer = make_param_groups("flat", PARAMS), adamw(learning_rate=1e-2, steps=10, warmup=1)
    step = TrainingStep(traced, groups, optimizer, ema_decay=0.9, seed=0, batch_size=4, devices=jax.devices()[:1])
    state = initial_state(PARAMS, groups, optimizer)
    for rows in (4, 8, 4, 8, 4):
        state, _ = step(state, np.ones((rows, 4), np.float32), np.arange(rows, dtype=np.uint32))
    assert state.step == 5
