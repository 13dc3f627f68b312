"""The gather form equals the mask form; caches are reusable; the losses of saap reach only what they train."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.nn.cross_attention import from_name
from tests.factories import golden
from tests.factories.attention_cases import CASES, IMAGE, KEYS, TEXT, apply, call, close, module, params_of, scenes

FORMS = {
    "windowed": (from_name("windowed", window=1), TEXT),
    "windowed image": (from_name("windowed", window=1), IMAGE),
    "windowed whole image": (from_name("windowed", window=2, per_modality=False, alignment="diagonal_rev"), IMAGE),
    "windowed fa2": (from_name("windowed", window=1, alignment="fa2"), TEXT),
    "squeezed": (from_name("squeezed", clusters=3, capacity=KEYS), TEXT),
    "squeezed none": (from_name("squeezed", clusters=3, pool="none", capacity=KEYS), TEXT),
    "squeezed top": (from_name("squeezed", clusters=3, rule="top", keep=0.4), TEXT),
    "squeezed top none": (from_name("squeezed", clusters=3, rule="top", keep=0.4, pool="none"), TEXT),
}


@pytest.mark.parametrize("name", FORMS)
def test_gather_form_equals_mask_form(name):
    """Values, metrics, and gradients of x and context. Some keys are left out, so that the test is no tautology."""
    options, spec = FORMS[name]
    x, x_mask, context, mask = scenes(spec)
    params = params_of(options, spec)

    def loss(x, context, form):
        y, aux = apply(dataclasses.replace(options, form=form), params, x, x_mask, context, mask, spec=spec)
        return jnp.sin(y).sum(), (y, aux.metrics)

    compiled = golden.jit(jax.value_and_grad(loss, (0, 1), has_aux=True), static_argnums=2)
    with jax.enable_x64(True):
        masked, gathered = (compiled(x, context, form) for form in ("mask", "gather"))
    jax.tree.map(close, gathered, masked)
    assert 0.1 < float(masked[0][1][1]["selected"]) < 0.95


def test_fa2_windows_may_be_empty():
    """Alignment at the last tokens: with two keys, the window of query 0 of four lies before the first key."""
    options, (x, x_mask, context, mask) = FORMS["windowed fa2"][0], scenes()
    few = mask & (np.arange(KEYS) < 2)[None]
    with jax.enable_x64(True):
        y = jax.device_get(call(options, params_of(options), x, x_mask, context, few)[0])
    assert not np.any(y[0, 0]) and np.all(np.abs(y[0, 1:4]).max(-1) > 1e-3)  # centre of query 0: 0 + 2 - 4


@pytest.mark.parametrize("name", ["concat", "linear", "agent learned", "saap joint", "deformable image", "squeezed"])
def test_cache_is_reusable_and_joins_by_scene(name):
    """Encoding once equals encoding before each of three steps, bit for bit; caches of scenes can be concatenated."""
    options, spec = CASES[name]
    network, (x, x_mask, context, mask) = module(options, spec), scenes(spec)
    params, x, context = jax.tree.map(
        lambda leaf: jnp.asarray(leaf, jnp.float32), (params_of(options, spec), x, context)
    )
    x_mask, mask = jnp.asarray(x_mask), jnp.asarray(mask)
    encode = golden.jit(lambda params, context, mask: network.apply(params, context, mask, method="encode"))
    attend = golden.jit(lambda params, x, cache: network.apply(params, x, x_mask, cache, method="attend")[0])
    cache = encode(params, context, mask)
    for step in range(3):
        np.testing.assert_array_equal(
            attend(params, x + step, cache), attend(params, x + step, encode(params, context, mask))
        )
    assert all(len(leaf) == 2 for leaf in jax.tree.leaves(cache))
    half = jax.tree.map(lambda leaf: leaf[:1], cache)
    joined = jax.tree.map(lambda a: jnp.concatenate([a, a]), half)
    y = attend(params, jnp.stack([x[0], x[0]]), joined)
    close(y[0], attend(params, x, cache)[0], 1e-6)


def test_saap_loss_trains_router_and_centroids_only():
    options = from_name("saap", mode="joint", buckets=4, probes=2)
    x, x_mask, context, mask = scenes()

    def loss(params, x, context):
        return apply(options, params, x, x_mask, context, mask)[1].loss

    with jax.enable_x64(True):
        params = params_of(options)
        value, (of_params, *others) = golden.jit(jax.value_and_grad(loss, (0, 1, 2)))(params, x, context)
    trained = {"router", "centroids"}
    assert np.isfinite(value)
    assert all(np.any(leaf) for name in trained for leaf in jax.tree.leaves(of_params[name]))
    rest = [leaf for name, leaf in of_params.items() if name not in trained]
    assert not any(np.any(leaf) for leaf in jax.tree.leaves([rest, others]))
