"""The conditioning mechanisms at their smallest, scenes for them, and one compiled program each for all tests."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np

from scjax.nn.cross_attention import OPTIONS, ContextSpec, build_cross_attention, from_name
from scjax.nn.functional import functional
from tests.factories import golden
from tests.factories.initial_values import initial_params

WIDTH, HEADS = 8, 2
QUERIES, KEYS = 6, 8
TEXT = ContextSpec(kind="text")
IMAGE = ContextSpec(kind="image", grid=(2, 2), modalities=2)

_SAAP = {"buckets": 4, "probes": 2, "router_width": 5}
_SQUEEZED = {"clusters": 3, "iterations": 3}
_VARIANTS = {
    "concat": (from_name("concat"), TEXT),
    "full": (from_name("full"), TEXT),
    "full memory": (from_name("full", memory_tokens=2), TEXT),
    "gated": (from_name("gated", feed_forward=True), TEXT),
    "linear": (from_name("linear"), TEXT),
    "linear dwc": (from_name("linear", dwc="value", qk_norm=True), IMAGE),
    "agent segment": (from_name("agent", tokens=3), TEXT),
    "agent learned": (from_name("agent", tokens=3, pooling="learned"), TEXT),
    "agent set": (from_name("agent", tokens=3, pooling="set"), TEXT),
    "agent bias": (from_name("agent", tokens=3, grid_bias=True), IMAGE),
    "saap": (from_name("saap", **_SAAP), TEXT),
    "saap joint": (from_name("saap", mode="joint", **_SAAP), TEXT),
    "windowed": (from_name("windowed", window=2), TEXT),
    "windowed image": (from_name("windowed", window=1), IMAGE),
    "windowed fa2": (from_name("windowed", window=2, alignment="fa2", form="gather"), TEXT),
    "deformable text": (from_name("deformable", points=2), TEXT),
    "deformable image": (from_name("deformable", points=2), IMAGE),
    "squeezed": (from_name("squeezed", **_SQUEEZED), TEXT),
    "squeezed top": (from_name("squeezed", rule="top", pool="none", form="gather", keep=0.5, **_SQUEEZED), TEXT),
    "cross_global": (from_name("cross_global", latent_tokens=3), TEXT),
}
_NAMED = {"none", *(options.name for options, _ in _VARIANTS.values())}
CASES = _VARIANTS | {name: (from_name(name), TEXT) for name in OPTIONS if name not in _NAMED}
"""Mechanisms with small options; one that has none here is tested with its defaults."""


@functools.lru_cache
def module(options, spec=TEXT, width=WIDTH, heads=HEADS, compute="float32"):
    """The mechanism as pure functions."""
    return functional(lambda init: build_cross_attention(options, width, heads, spec, init=init, compute=compute))


@functools.lru_cache
def params_of(options, spec=TEXT, width=WIDTH, heads=HEADS):
    """Every leaf random, so that no branch is idle, and the statistics as if they had been fitted."""
    params = initial_params(lambda init: build_cross_attention(options, width, heads, spec, init=init), noise=0.4)
    params = jax.tree.map(np.float64, params)
    fitted = {"fitted": np.ones(1), "threshold": np.full(1, 0.9)}
    return {**params, **{name: value for name, value in fitted.items() if name in params}}


def apply(options, params, x, x_mask, context, mask, spec=TEXT, heads=HEADS, compute="float32"):
    """y and aux: attend after encode."""
    network = module(options, spec, x.shape[-1], heads, compute)
    params, x, x_mask, context, mask = jax.tree.map(jnp.asarray, (params, x, x_mask, context, mask))
    cache = network.apply(params, context, mask, method="encode")
    return network.apply(params, x, x_mask, cache, method="attend")


@functools.lru_cache
def _compiled(options, **choices):
    return golden.jit(functools.partial(apply, options, **choices))


def call(options, *arguments, **choices):
    """``apply``, compiled."""
    return _compiled(options, **choices)(*arguments)


@functools.cache
def _program(case: str):
    options, spec = CASES[case]
    network = module(options, spec)

    def loss(params, x, context, x_mask, mask):
        cache = network.apply(params, context, mask, method="encode")
        y, aux = network.apply(params, x, x_mask, cache, method="attend")
        weight = jnp.cos(jnp.arange(WIDTH, dtype=y.dtype))[None, None]
        return (jnp.sin(y) * weight).sum(), (y, aux)

    return golden.jit(jax.value_and_grad(loss, (0, 1, 2), has_aux=True))


def evaluate(case: str, x, x_mask, context, mask, params=None):
    """In float64: (loss of y, y, aux), and the gradients of the loss by parameters, x and context."""
    with jax.enable_x64(True):
        params = params_of(*CASES[case]) if params is None else params
        (loss, (y, aux)), gradients = jax.device_get(_program(case)(params, x, context, x_mask, mask))
    return (float(loss), y, aux), gradients


def scenes(spec=TEXT, seed=0):
    """x, x_mask, context, mask of two scenes of different sizes, padding zero; an image's grids are equally full."""
    rng = np.random.default_rng(seed)
    x_mask = np.arange(QUERIES)[None] < np.array([[4], [5]])
    parts = spec.modalities
    cells = np.arange(KEYS // parts)[None] < np.array([[6], [4]]) // parts
    mask = np.concatenate([cells] * parts, 1)
    x, context = (rng.normal(size=(2, size, WIDTH)) for size in (QUERIES, KEYS))
    return np.where(x_mask[..., None], x, 0), x_mask, np.where(mask[..., None], context, 0), mask


def clustered_tokens(seed, scenes, tokens):
    """Tokens [scenes, tokens, WIDTH] around four directions."""
    rng = np.random.default_rng(seed)
    centres = 4 * np.linalg.qr(rng.normal(size=(WIDTH, 4)))[0].T
    return (centres[rng.integers(4, size=(scenes, tokens))] + 0.1 * rng.normal(size=(scenes, tokens, WIDTH))).astype(
        np.float32
    )


def moved(array, mask, new_mask, fill):
    """The rows of ``array`` at ``mask``, in order, at ``new_mask``; ``fill`` elsewhere."""
    out = np.full_like(array, fill)
    for row, old, new, source in zip(out, mask, new_mask, array, strict=True):
        row[new] = source[old]
    return out


def scattered(mask, parts, seed):
    """As many True entries in each of ``parts`` equal parts of a row, at random places."""
    rng = np.random.default_rng(seed)
    cells = mask.reshape(len(mask), parts, -1)
    return rng.permuted(cells, axis=-1).reshape(mask.shape)


def close(a, b, tolerance=1e-10):
    """Asserts equality up to ``tolerance``, relative to the largest entry (at least 1)."""
    a, b = np.asarray(a), np.asarray(b)
    np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance * max(1.0, np.abs(b).max(initial=0)))
