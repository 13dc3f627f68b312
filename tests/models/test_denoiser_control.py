"""Every conditioning mechanism in the denoiser: trained, exported, sampled with its cache, written and read."""

from __future__ import annotations

import functools
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.guidance import guided, join
from scjax.diffusion.loss import LatentBatch, training_loss
from scjax.diffusion.sampler import sample
from scjax.diffusion.schedule import cosine_schedule, respaced
from scjax.model import _denoiser_config, _described
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ImageFeatures, TextFeatures
from scjax.models.denoiser.model import denoiser
from scjax.models.nodes import Nodes
from scjax.nn.control import OPTIONS, named
from scjax.nn.functional import flatten
from tests import golden

CONDITIONS = {"text": TextCondition(width=4), "image": ImageCondition(channels=3, grid=(2, 2), patch=2)}
SMALL = {
    "full": {"memory_tokens": 2}, "agent": {"tokens": 3}, "windowed": {"window": 1}, "deformable": {"points": 2},
    "saap": {"mode": "joint", "buckets": 4, "probes": 2, "router_width": 5}, "cross_global": {"latent_tokens": 3},
    "squeezed": {"clusters": 3, "iterations": 3, "rule": "top"},
}  # fmt: skip
STATISTICS = {"fitted", "threshold"}
WIDTHS = Nodes(agents=3, lanes=5)


def _config(name, kind):
    return DenoiserConfig(
        lane_width=8, lane_heads=2, agent_width=8, agent_heads=2, blocks=1, mlp_ratio=1, lane_latent=5, agent_latent=3,
        max_lanes=9, max_agents=7, condition=CONDITIONS[kind], control=named(name, **SMALL.get(name, {})),
    )  # fmt: skip


def _batch(kind):
    rng = np.random.default_rng(0)
    masks = Nodes(agents=np.arange(4)[None] < np.array([[4], [2]]), lanes=np.arange(5)[None] < np.array([[3], [5]]))
    latents = jax.tree.map(lambda mask, width: rng.normal(size=(*mask.shape, width)), masks, WIDTHS)
    features = ImageFeatures(dino=rng.normal(size=(2, 3, 2, 2)), depth=rng.random((2, 4, 4)))
    if kind == "text":
        features = TextFeatures(tokens=rng.normal(size=(2, 6, 4)), mask=np.arange(6)[None] < np.array([[6], [3]]))
    batch = LatentBatch(
        latents=latents,
        masks=masks,
        given=jax.tree.map(np.zeros_like, masks),
        label=np.array([1, 7]),
        condition=features,
    )
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32 if x.dtype == np.float64 else None), batch)


@functools.cache
def _network(name, kind):
    return denoiser(_config(name, kind))


def _trained_and_sampled(name, kind, params, batch, key):
    """(loss, terms), gradients by parameters and features, and samples under guidance from two kinds of caches."""
    network, config = _network(name, kind), _config(name, kind)

    def loss(params, condition):
        return training_loss(
            network, params, cosine_schedule(), batch.replace(condition=condition), key, null_label=config.null_label
        )

    def apply(cache):
        labels, twice = join(batch.label, jnp.full_like(batch.label, config.null_label)), join(batch.masks, batch.masks)
        denoise = guided(lambda z, t: network.apply(params, z, t, labels, twice, None, cache), 2.0)
        return sample(
            denoise, respaced(cosine_schedule(), 2), jax.random.split(key, 2), batch.masks, widths=WIDTHS,
            most=Nodes(agents=7, lanes=9),
        )  # fmt: skip

    def encode(absent):
        return network.apply(params, batch.condition, jnp.full(2, absent), method="encode_condition")

    trained = jax.value_and_grad(loss, (0, 1), has_aux=True, allow_int=True)(params, batch.condition)
    return *trained, apply(encode(False)), apply(join(encode(False), encode(True)))


@pytest.mark.parametrize("kind", CONDITIONS)
@pytest.mark.parametrize("name", OPTIONS)
def test_trains_exports_and_samples(name, kind):
    """Through a serialised export; guidance without a null cache is guidance with the cache of dropped conditions."""
    shapes = jax.eval_shape(_network(name, kind).init, jax.random.key(0))
    rng = np.random.default_rng(1)
    params = jax.tree.map(lambda leaf: jnp.asarray(0.3 * rng.normal(size=leaf.shape), jnp.float32), shapes)
    arguments = params, _batch(kind), jax.random.key(2)
    exported = jax.export.export(jax.jit(functools.partial(_trained_and_sampled, name, kind)))(*arguments)
    program = jax.export.deserialize(exported.serialize())
    (loss, terms), (of_params, of_condition), short, joined = golden.jit(program.call)(*arguments)
    assert np.isfinite(loss) and ("control" in terms) == (name == "saap")
    np.testing.assert_allclose(loss, terms["total"] + terms.get("control", 0), rtol=1e-6)
    crossed = {path: np.asarray(leaf) for path, leaf in flatten(of_params).items() if "cross" in path}
    assert bool(crossed) == (name != "none")
    assert all(np.all(np.isfinite(leaf)) for leaf in crossed.values())
    idle = {path for path, leaf in crossed.items() if not np.any(leaf)}
    assert {path[-1] for path in idle if path[-2:] != ("k_norm", "bias")} <= STATISTICS, idle
    features = of_condition.tokens if kind == "text" else of_condition.dino
    assert np.any(features) == (name != "none")
    for one, other in zip(jax.tree.leaves(short), jax.tree.leaves(joined), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", OPTIONS)
def test_configs_are_written_and_read(name):
    for kind in CONDITIONS:
        config = _config(name, kind)
        assert _denoiser_config(json.loads(json.dumps(_described(config)))) == config
        assert hash(config) == hash(_config(name, kind))


def test_a_control_must_be_options():
    with pytest.raises(ValueError, match="must be the options of a mechanism"):
        DenoiserConfig(control="windowed")  # pyright: ignore
