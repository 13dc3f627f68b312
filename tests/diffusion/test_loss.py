"""The training loss: padding, random choices, and its value for simple networks."""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.loss import LatentBatch, _drop_one, diffusion_loss, training_loss
from scjax.diffusion.schedule import cosine_schedule
from scjax.diffusion.timestep_sampling import TimestepSampling
from scjax.models.denoiser.config import DenoiserConfig, TextCondition
from scjax.models.denoiser.context import TextFeatures
from scjax.models.denoiser.model import denoiser
from scjax.nn.cross_attention import CrossGlobalOptions
from scjax.scene.per_type import PerType
from tests.factories import golden

CONFIG = DenoiserConfig(
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
    cross_attention=CrossGlobalOptions(latent_tokens=2),
    condition=TextCondition(width=4),
    known_embedding=True,
)
NETWORK = denoiser(CONFIG)
SCHEDULE = cosine_schedule()


@functools.cache
def _params():
    params = jax.device_get(NETWORK.init(jax.random.key(0)))  # adding to arrays of a device compiles for every shape
    leaves, tree = jax.tree.flatten(params)
    noise = [np.random.default_rng(i).normal(size=leaf.shape) for i, leaf in enumerate(leaves)]
    return jax.device_put(
        jax.tree.unflatten(tree, [np.float32(x + 0.2 * y) for x, y in zip(leaves, noise, strict=True)])
    )


def _batch(garbage=0.0):
    """Two scenes of different sizes; padding holds ``garbage``."""
    rng = np.random.default_rng(0)
    masks = PerType(agents=np.arange(4)[None] < np.array([[4], [2]]), lanes=np.arange(5)[None] < np.array([[3], [5]]))
    latents = jax.tree.map(
        lambda mask, width: np.where(mask[..., None], rng.normal(size=(*mask.shape, width)), garbage),
        masks,
        PerType(agents=3, lanes=5),
    )
    known = jax.tree.map(lambda mask: mask & (rng.random(mask.shape) < 0.3), masks)
    token_mask = np.arange(3)[None] < np.array([[3], [2]])
    tokens = np.where(token_mask[..., None], rng.normal(size=(2, 3, 4)), garbage).astype(np.float32)
    batch = LatentBatch(
        latents=latents,
        masks=masks,
        known=known,
        label=np.array([1, 7]),
        condition=TextFeatures(tokens=tokens, mask=token_mask),
        has_condition=np.array([True, True]),
        agent_weight=np.where(masks.agents, 1.0, garbage).astype(np.float32),
    )
    return jax.device_put(jax.tree.map(lambda x: np.float32(x) if x.dtype == np.float64 else x, batch))


@golden.jit
def _evaluate(params, batch, key, label_dropout, condition_dropout):
    loss = functools.partial(
        training_loss,
        NETWORK,
        schedule=SCHEDULE,
        batch=batch,
        key=key,
        null_label=CONFIG.null_label,
        label_dropout=label_dropout,
        condition_dropout=condition_dropout,
    )
    return jax.value_and_grad(loss, has_aux=True)(params)


@pytest.mark.parametrize("garbage", [np.nan, 1e30])
def test_padding_never_matters(garbage):
    clean = _evaluate(_params(), _batch(), jax.random.key(3), 0.1, 0.1)
    padded = _evaluate(_params(), _batch(garbage), jax.random.key(3), 0.1, 0.1)
    jax.tree.map(np.testing.assert_array_equal, clean, padded)


def _loss(batch, label_dropout, condition_dropout):
    return float(_evaluate(_params(), batch, jax.random.key(3), label_dropout, condition_dropout)[0][0])


def test_label_and_condition_dropout_change_the_loss():
    assert _loss(_batch(), 0.0, 0.0) != _loss(_batch(), 1.0, 0.0) != _loss(_batch(), 1.0, 1.0)


def test_a_dropped_label_is_the_null_label():
    batch = _batch()
    null = batch.replace(label=jnp.full_like(batch.label, CONFIG.null_label))
    assert _loss(null, 0.0, 0.0) == _loss(batch, 1.0, 0.0)


def test_a_scene_without_condition_is_a_dropped_condition():
    batch = _batch()
    unconditional = batch.replace(has_condition=jnp.zeros_like(batch.has_condition))
    assert _loss(unconditional, 0.0, 0.0) == _loss(batch, 0.0, 1.0)


def test_some_scenes_have_a_request_or_a_condition_alone():
    dropped = jnp.arange(10_000) < 1000
    batch = _batch().replace(attributes=jnp.ones((10_000, 1)))
    attributes, no_condition = _drop_one(batch, dropped, jax.random.key(0))
    no_request = ~np.asarray(attributes[:, 0] > 0)
    assert no_request[:1000].all() and no_condition[:1000].all()
    assert no_request[1000:].mean() == pytest.approx(0.2, abs=0.02)
    assert no_condition[1000:].mean() == pytest.approx(0.3, abs=0.02)
    assert not (no_request & no_condition)[1000:].any()
    attributes, no_condition = _drop_one(batch.replace(condition=None), dropped, jax.random.key(0))
    np.testing.assert_array_equal(attributes[:, 0] == 0, dropped)
    np.testing.assert_array_equal(no_condition, dropped)


def test_kinds_are_dropped_by_their_own_share():
    network = denoiser(dataclasses.replace(CONFIG, condition=None, agent_kinds=(2,), lane_kinds=(2,)))
    rng, params = np.random.default_rng(0), jax.device_get(network.init(jax.random.key(0)))
    params = jax.tree.map(lambda leaf: leaf + rng.normal(0, 0.1, np.shape(leaf)).astype(np.float32), params)
    batch = _batch().replace(condition=None, has_condition=None)

    @golden.jit
    def loss_of(params, kinds, kind_dropout):
        options = {"null_label": CONFIG.null_label, "condition_dropout": 0.0, "kind_dropout": kind_dropout}
        given = batch.replace(kinds=kinds)
        return training_loss(network, params, SCHEDULE, given, jax.random.key(3), **options)[0]

    loss = functools.partial(loss_of, params)
    kinds = jax.tree.map(lambda mask: jnp.ones(mask.shape, jnp.int32), batch.masks)
    nothing = jax.tree.map(lambda kind: -kind, kinds)
    assert loss(kinds, 0.0) != loss(nothing, 0.0)
    assert loss(kinds, 1.0) == loss(nothing, 0.0)


def test_random_choices_follow_the_key():
    first, same, other = (_evaluate(_params(), _batch(), jax.random.key(i), 0.5, 0.5)[0][0] for i in (1, 1, 2))
    assert first == same != other


def test_the_loss_of_a_zero_flow_network_is_that_of_its_target():
    """The target is eps - x_0: per number 1 + x_0^2 on average, halved, agents once and lanes ten times."""
    network = denoiser(dataclasses.replace(CONFIG, prediction="flow"))
    params, batch = network.init(jax.random.key(0)), _batch()  # its heads are zero
    batch = batch.replace(agent_weight=None, known=jax.tree.map(jnp.zeros_like, batch.known))
    timestep_sampling = TimestepSampling("logit-normal", continuous=True)

    @golden.jit
    def losses(keys):
        return jax.lax.map(
            lambda key: training_loss(
                network,
                params,
                SCHEDULE,
                batch,
                key,
                null_label=CONFIG.null_label,
                prediction="flow",
                timestep_sampling=timestep_sampling,
            )[0],
            keys,
        )

    scene = jax.tree.map(
        lambda x, mask: (jnp.where(mask[..., None], x, 0) ** 2).mean(-1).sum(-1) / mask.sum(-1),
        batch.latents,
        batch.masks,
    )
    expected = ((1 + scene.agents) + 10 * (1 + scene.lanes)).mean() / 2
    values = losses(jax.random.split(jax.random.key(1), 300))
    np.testing.assert_allclose(values.mean(), expected, rtol=0.03)


def test_agents_of_weight_zero_do_not_count():
    batch = _batch()
    agent_weight = jnp.zeros_like(batch.agent_weight).at[:, 0].set(1)
    nothing_known = jax.tree.map(jnp.zeros_like, batch.known)
    noise = jax.tree.map(jnp.ones_like, batch.latents)

    def denoise(z, t):
        return z.replace(agents=z.agents.at[:, 0].set(3.0), lanes=jnp.ones_like(z.lanes))

    level = SCHEDULE.levels[jnp.array([10, 20])]
    loss, terms = diffusion_loss(
        denoise, level, batch.latents, noise, batch.masks, nothing_known, agent_weight=agent_weight
    )
    np.testing.assert_allclose(terms["agent"], 2.0)
    np.testing.assert_allclose(loss, 2.0)
