"""Every conditioning mechanism in the denoiser: trained, exported, sampled, written and read."""

from __future__ import annotations

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.guidance import concat_branches, with_guidance
from scjax.diffusion.loss import LatentBatch, training_loss
from scjax.diffusion.schedule import cosine_schedule
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ImageFeatures, TextFeatures
from scjax.models.denoiser.model import denoiser
from scjax.nn.cross_attention import OPTIONS, from_name
from scjax.nn.functional import flatten
from scjax.scene.per_type import PerType
from tests.factories import golden

CONDITIONS = {"text": TextCondition(width=4), "image": ImageCondition(channels=3, grid=(2, 2), patch=2)}
SMALL = {
    "full": {"memory_tokens": 2},
    "agent": {"tokens": 3},
    "windowed": {"window": 1},
    "deformable": {"points": 2},
    "saap": {"mode": "joint", "buckets": 4, "probes": 2, "router_width": 5},
    "cross_global": {"latent_tokens": 3},
    "squeezed": {"clusters": 3, "iterations": 3, "rule": "top"},
}
STATISTICS = {"fitted", "threshold"}
WIDTHS = PerType(agents=3, lanes=5)


def _config(name, kind):
    return DenoiserConfig(
        lane_width=8,
        lane_heads=2,
        agent_width=8,
        agent_heads=2,
        blocks=1,
        mlp_ratio=1,
        lane_latent=5,
        agent_latent=3,
        max_lanes=9,
        max_agents=7,
        condition=CONDITIONS[kind],
        cross_attention=from_name(name, **SMALL.get(name, {})),
    )


def _batch(kind):
    rng = np.random.default_rng(0)
    masks = PerType(agents=np.arange(4)[None] < np.array([[4], [2]]), lanes=np.arange(5)[None] < np.array([[3], [5]]))
    latents = jax.tree.map(lambda mask, width: rng.normal(size=(*mask.shape, width)), masks, WIDTHS)
    features = ImageFeatures(dino=rng.normal(size=(2, 3, 2, 2)), depth=rng.random((2, 4, 4)))
    if kind == "text":
        features = TextFeatures(tokens=rng.normal(size=(2, 6, 4)), mask=np.arange(6)[None] < np.array([[6], [3]]))
    batch = LatentBatch(
        latents=latents,
        masks=masks,
        known=jax.tree.map(np.zeros_like, masks),
        label=np.array([1, 7]),
        condition=features,
    )
    return jax.device_put(jax.tree.map(lambda x: np.float32(x) if x.dtype == np.float64 else x, batch))


@functools.cache
def _network(name, kind):
    return denoiser(_config(name, kind))


@functools.cache
def _params(name, kind):
    shapes = jax.eval_shape(_network(name, kind).init, jax.random.key(0))
    rng = np.random.default_rng(1)
    return jax.device_put(jax.tree.map(lambda leaf: np.float32(0.3 * rng.normal(size=leaf.shape)), shapes))


def _training(name, kind):
    """Loss and gradients by parameters and features, as a function, and its arguments."""
    network, null_label = _network(name, kind), _config(name, kind).null_label

    def loss(params, condition, batch, key):
        batch = batch.replace(condition=condition)
        return training_loss(network, params, cosine_schedule(), batch, key, null_label=null_label)

    batch = _batch(kind)
    arguments = _params(name, kind), batch.condition, batch.replace(condition=None), jax.random.key(2)
    return jax.jit(jax.value_and_grad(loss, (0, 1), has_aux=True, allow_int=True)), arguments


@pytest.mark.parametrize("name", ["saap", "deformable", "squeezed", "cross_global"])
def test_image_training_program_exports(name):
    """Lowered without running; a gradient for every parameter. These make most of the operations of all."""
    function, arguments = _training(name, "image")
    exported = jax.export.export(function)(*arguments)
    (_, terms), (of_params, _) = jax.tree.unflatten(exported.out_tree, exported.out_avals)
    assert ("cross_attention" in terms) == (name == "saap")
    assert jax.tree.map(lambda leaf: leaf.shape, of_params) == jax.tree.map(lambda leaf: leaf.shape, arguments[0])


def test_text_gradients_are_finite(name="saap"):
    """A loss of its own is added to the scenes'; gradients reach every parameter but statistics, and the features.

    (Of the mechanism that has such a loss; those of all are a test of test_stage_cross_attention.py.)
    """
    function, arguments = _training(name, "text")
    exported = jax.export.export(function)(*arguments)
    (value, terms), (of_params, of_condition) = golden.jit(exported.call)(*arguments)
    assert np.isfinite(value) and "cross_attention" in terms
    np.testing.assert_allclose(value, terms["total"] + terms["cross_attention"], rtol=1e-6)
    crossed = {path: np.asarray(leaf) for path, leaf in flatten(of_params).items() if "cross" in path}
    assert all(np.all(np.isfinite(leaf)) for leaf in crossed.values())
    idle = {path for path, leaf in crossed.items() if not np.any(leaf)}
    assert {path[-1] for path in idle if path[-2:] != ("k_norm", "bias")} == STATISTICS & {p[-1] for p in crossed}
    assert np.any(of_condition.tokens)


@pytest.mark.parametrize("name", OPTIONS)
def test_text_estimates(name):
    """A cache of the first scenes serves a larger batch; another prompt changes their estimates and no other."""
    network, batch = _network(name, "text"), _batch("text")
    labels, masks, z = (concat_branches(part, part) for part in (batch.label, batch.masks, batch.latents))

    @golden.jit
    def run(params, features):
        cache = network.apply(params, features, jnp.zeros(2, bool), method="encode_condition")
        return network.apply(params, z, jnp.array([3, 50, 3, 50]), labels, masks, cache=cache)

    features = batch.condition
    one, other = (run(_params(name, "text"), part) for part in (features, features.replace(tokens=-features.tokens)))
    for a, b, mask in zip(*map(jax.tree.leaves, (one, other, masks)), strict=True):
        assert np.all(np.isfinite(a)) and not np.any(a[~mask])
        np.testing.assert_array_equal(a[2:], b[2:])
        assert np.array_equal(a[:2], b[:2]) == (name == "none")


def test_guidance_needs_no_null_cache(name="concat"):
    """Guided estimates with one cache: the branch without a condition is what training drops to, though not zero."""
    network, config, batch = _network(name, "text"), _config(name, "text"), _batch("text")
    labels, twice = (
        concat_branches(batch.label, jnp.full_like(batch.label, config.null_label)),
        concat_branches(batch.masks, batch.masks),
    )

    @golden.jit
    def run(params):
        def encode(absent):
            return network.apply(params, batch.condition, jnp.full(2, absent), method="encode_condition")

        def estimate(cache):
            denoise = with_guidance(lambda z, t: network.apply(params, z, t, labels, twice, None, cache), 2.0)
            return denoise(batch.latents, jnp.array([50, 50]))

        return estimate(encode(False)), estimate(concat_branches(encode(False), encode(True)))

    short, whole = run(_params(name, "text"))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4), short, whole)


def test_no_cache_is_a_dropped_condition():
    """Also for concat, whose scene tokens then read each other."""
    network, batch = _network("concat", "image"), _batch("image")

    @golden.jit
    def run(params):
        dropped = network.apply(params, batch.condition, jnp.ones(2, bool), method="encode_condition")
        t = jnp.array([3, 50])
        return [network.apply(params, batch.latents, t, batch.label, batch.masks, cache=c) for c in (dropped, None)]

    with_cache, without = run(_params("concat", "image"))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5), without, with_cache)


@pytest.mark.parametrize("name", OPTIONS)
def test_config_round_trip(name):
    for kind in CONDITIONS:
        config = _config(name, kind)
        assert DenoiserConfig.from_json(json.loads(json.dumps(config.to_json()))) == config
        assert hash(config) == hash(_config(name, kind))
