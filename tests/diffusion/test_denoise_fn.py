"""Precomputed modulation, condition caches and both guidance branches change no result."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.defaults import MAX_PRECOMPUTED
from scjax.diffusion.denoise_fn import denoise_fn, prepare_denoiser_inputs
from scjax.diffusion.guidance import Guidance
from scjax.diffusion.samplers import DPMSolver, Heun, make_schedule
from scjax.diffusion.samplers.loop import sample_latents
from scjax.models.denoiser.config import DenoiserConfig, TextCondition
from scjax.models.denoiser.context import TextFeatures
from scjax.models.denoiser.model import denoiser
from scjax.nn.cross_attention import CrossGlobalOptions
from scjax.scene.per_type import PerType
from tests.factories import golden

LATENT_WIDTHS, MAX_TOKENS = PerType(agents=3, lanes=5), PerType(agents=4, lanes=6)
MASKS = PerType(agents=jnp.arange(4)[None] < jnp.array([[4], [2]]), lanes=jnp.arange(6)[None] < jnp.array([[3], [6]]))
KNOWN = PerType(agents=MASKS.agents & (jnp.arange(4) < 1)[None], lanes=MASKS.lanes & (jnp.arange(6) < 2)[None])
LABEL = jnp.array([1, 5])
SCALE = 3.0


def random_denoiser(prediction):
    """(network, config, params) with random values in every parameter."""
    config = DenoiserConfig(
        lane_width=16,
        lane_heads=2,
        agent_width=8,
        agent_heads=2,
        blocks=1,
        mlp_ratio=1,
        lane_latent=5,
        agent_latent=3,
        max_lanes=6,
        max_agents=4,
        cross_attention=CrossGlobalOptions(latent_tokens=2),
        condition=TextCondition(width=4),
        known_embedding=True,
        attributes=("layout=T", "vehicles>=1"),
        prediction=prediction,
    )
    network = denoiser(config)
    rng = np.random.default_rng(0)
    params = jax.tree.map(lambda leaf: rng.normal(0, 0.2, leaf.shape), network.shapes())
    return network, config, params


def make_denoise(
    network_config_params, times, max_precomputed, *, guidance, known=None, features=None, attributes=None
):
    network, config, params = network_config_params
    inputs = prepare_denoiser_inputs(
        network,
        config,
        params,
        LABEL,
        MASKS,
        times=times,
        guided=guidance is not None,
        known=known,
        attributes=attributes,
        features=features,
        max_precomputed=max_precomputed,
    )
    return denoise_fn(network, params, inputs, times=times, guidance=guidance, guidance_scale=SCALE)


@pytest.mark.parametrize(
    ("sampler", "prediction", "guidance"),
    [
        (DPMSolver(), "velocity", Guidance(3.0, interval=(20, 80), rescale=0.5)),
        (Heun(), "flow", None),
    ],
)
def test_precomputed_modulation_leaves_samples_unchanged(sampler, prediction, guidance):
    """Whole samples in float64, with known tokens, condition caches and both branches."""
    network, config, params = random_denoiser(prediction)
    schedule = make_schedule(sampler, prediction, 5)
    with jax.enable_x64(True):
        rng = np.random.default_rng(1)
        features = TextFeatures(tokens=jnp.asarray(rng.normal(size=(2, 3, 4))), mask=jnp.ones((2, 3), bool))
        known_latents = jax.tree.map(lambda mask, width: jnp.ones((*mask.shape, width)), MASKS, LATENT_WIDTHS)
        params = jax.device_put(params)

        def run(max_precomputed):
            denoise = make_denoise(
                (network, config, params),
                schedule.levels.time,
                max_precomputed,
                known=KNOWN,
                features=features,
                attributes=jnp.asarray([[1.0, 0.5], [0.0, 0.0]]),
                guidance=guidance,
            )
            return sample_latents(
                denoise,
                schedule,
                jax.random.split(jax.random.key(0)),
                MASKS,
                sampler=sampler,
                prediction=prediction,
                known=KNOWN,
                known_latents=known_latents,
                latent_widths=LATENT_WIDTHS,
                max_tokens=MAX_TOKENS,
                dtype=jnp.float64,
            )

        precomputed, per_step = (golden.jit(run, static_argnums=0)(limit) for limit in (2**25, 0))
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-8), precomputed, per_step)
        assert np.abs(precomputed.lanes[1]).max() > 0.1


def test_one_evaluation_agrees_in_float32():
    """To 1e-6 per branch; guidance with scale 3 returns 3 c - 2 u, which makes it 5e-6."""
    network, config, params = random_denoiser("velocity")
    params = jax.device_put(jax.tree.map(np.float32, params))
    rng = np.random.default_rng(2)
    z = jax.tree.map(lambda m, w: jnp.asarray(rng.normal(size=(*m.shape, w)), jnp.float32), MASKS, LATENT_WIDTHS)
    times = np.array([3, 40, 99])

    def evaluate(max_precomputed, t):
        denoise = make_denoise((network, config, params), times, max_precomputed, guidance=Guidance())
        return denoise(z, jnp.broadcast_to(t, 2))

    precomputed, per_step = golden.jit(evaluate, static_argnums=0), golden.jit(lambda t: evaluate(0, t))
    for t in times:
        jax.tree.map(
            lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-6, atol=5e-6),
            precomputed(2**25, t),
            per_step(jnp.asarray(t)),
        )


def test_guidance_leads_away_from_a_request_for_nothing():
    """A scale of 0 is the unconditional branch: the request does not matter there, and without one neither does 1."""
    network, config, params = random_denoiser("velocity")
    params = jax.device_put(jax.tree.map(np.float32, params))
    rng = np.random.default_rng(3)
    z = jax.tree.map(lambda m, w: jnp.asarray(rng.normal(size=(*m.shape, w)), jnp.float32), MASKS, LATENT_WIDTHS)
    times = np.array([3, 40])

    def evaluate(attributes, scale):
        inputs = prepare_denoiser_inputs(
            network, config, params, LABEL, MASKS, times=times, guided=True, attributes=attributes
        )
        denoise = denoise_fn(network, params, inputs, times=times, guidance=Guidance(), guidance_scale=scale)
        return denoise(z, jnp.full(2, 40)).lanes

    run = golden.jit(evaluate)
    requests, nothing = jnp.asarray([[1.0, 0.0], [0.0, 0.7]]), jnp.zeros((2, 2))
    np.testing.assert_array_equal(run(requests, 0.0), run(nothing, 0.0))
    assert (np.abs(run(requests, 1.0) - run(nothing, 1.0)).max((1, 2)) > 1e-3).all()


def test_modulation_above_the_limit_is_not_precomputed():
    """A row holds six chunks per stage, six of the source, three of the cross attention, and those of the heads."""
    network, config, params = random_denoiser("velocity")
    params = jax.device_put(jax.tree.map(np.float32, params))
    times = np.arange(7)
    lane, agent = 16, 8
    row = (6 + 6 + 3 + 6 + 3) * (lane + agent) + 2 * (lane + agent)
    for limit, precomputed in ((7 * 2 * row, True), (7 * 2 * row - 1, False)):
        inputs = prepare_denoiser_inputs(
            network, config, params, LABEL, MASKS, times=times, guided=False, max_precomputed=limit
        )
        assert (inputs.conditional.modulation is not None) == precomputed and inputs.unconditional is None
    assert MAX_PRECOMPUTED * 4 == 128 * 2**20  # bytes, as its docstring says
