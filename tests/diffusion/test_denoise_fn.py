"""What is computed before the loop changes nothing: modulation of all steps, caches of the condition, both branches."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion import denoise_fn as module
from scjax.diffusion.denoise_fn import make_denoise_fn, modulation_ahead
from scjax.diffusion.guidance import Guidance
from scjax.diffusion.samplers import DPMSolver, Heun, schedule_of
from scjax.diffusion.samplers.loop import sample
from scjax.models.denoiser.config import DenoiserConfig, TextCondition
from scjax.models.denoiser.context import TextFeatures
from scjax.models.denoiser.model import denoiser
from scjax.nn.cross_attention import CrossGlobalOptions
from scjax.scene.per_type import PerType
from tests.factories import golden

WIDTHS, MOST = PerType(agents=3, lanes=5), PerType(agents=4, lanes=6)
MASKS = PerType(agents=jnp.arange(4)[None] < jnp.array([[4], [2]]), lanes=jnp.arange(6)[None] < jnp.array([[3], [6]]))
GIVEN = PerType(agents=MASKS.agents & (jnp.arange(4) < 1)[None], lanes=MASKS.lanes & (jnp.arange(6) < 2)[None])


def generated(prediction):
    """(network, config, params): every leaf random."""
    config = DenoiserConfig(
        lane_width=16, lane_heads=2, agent_width=8, agent_heads=2, blocks=1, mlp_ratio=1, lane_latent=5, agent_latent=3,
        max_lanes=6, max_agents=4, cross_attention=CrossGlobalOptions(latent_tokens=2), condition=TextCondition(width=4),
        known_embedding=True, prediction=prediction,
    )  # fmt: skip
    network = denoiser(config)
    rng = np.random.default_rng(0)
    params = jax.tree.map(lambda leaf: rng.normal(0, 0.2, leaf.shape), network.init(jax.random.key(0)))
    return network, config, params


@pytest.mark.parametrize(
    ("sampler", "prediction", "guidance"),
    [
        (DPMSolver(), "velocity", Guidance(3.0, interval=(20, 80), rescale=0.5)),
        (Heun(), "flow", None),
    ],
)
def test_modulation_of_all_steps_at_once_changes_nothing(sampler, prediction, guidance):
    """Whole samples in float64, with given tokens, caches and both branches."""
    network, config, params = generated(prediction)
    schedule = schedule_of(sampler, prediction, 5)
    with jax.enable_x64(True):
        rng = np.random.default_rng(1)
        features = TextFeatures(tokens=jnp.asarray(rng.normal(size=(2, 3, 4))), mask=jnp.ones((2, 3), bool))
        values = jax.tree.map(lambda mask, width: jnp.ones((*mask.shape, width)), MASKS, WIDTHS)
        params = jax.tree.map(jnp.asarray, params)

        def run(most_ahead):
            denoise = make_denoise_fn(
                network, config, params, jnp.array([1, 5]), MASKS, times=schedule.levels.time, known=GIVEN,
                features=features, guidance=guidance, weight=3.0, most_ahead=most_ahead,
            )  # fmt: skip
            return sample(
                denoise, schedule, jax.random.split(jax.random.key(0)), MASKS, sampler=sampler, prediction=prediction,
                known=GIVEN, values=values, widths=WIDTHS, most=MOST, dtype=jnp.float64,
            )  # fmt: skip

        ahead, within = (golden.jit(run, static_argnums=0)(most) for most in (2**25, 0))
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-8), ahead, within)
        assert np.abs(ahead.lanes[1]).max() > 0.1


def test_one_evaluation_in_float32_agrees_to_rounding():
    """To 1e-6 a branch; guidance 2 (c - u) + u = 2 c - u makes three of them."""
    network, config, params = generated("velocity")
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params)
    rng = np.random.default_rng(2)
    z = jax.tree.map(lambda m, w: jnp.asarray(rng.normal(size=(*m.shape, w)), jnp.float32), MASKS, WIDTHS)
    times = np.array([3, 40, 99])

    def at(most_ahead, t):
        denoise = make_denoise_fn(
            network, config, params, jnp.array([1, 5]), MASKS, times=times, guidance=Guidance(), weight=2.0,
            most_ahead=most_ahead,
        )  # fmt: skip
        return denoise(z, jnp.broadcast_to(t, 2))

    ahead, within = golden.jit(at, static_argnums=0), golden.jit(lambda t: at(0, t))
    for t in times:
        jax.tree.map(
            lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-6, atol=3e-6), ahead(2**25, t), within(jnp.asarray(t))
        )


def test_too_many_numbers_are_not_held():
    """A row of this network: six chunks in each stage, six of the source, three of the cross attention; the heads."""
    network, _, params = generated("velocity")
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params)
    label, times = jnp.array([1, 5]), np.arange(7)
    lane, agent = 16, 8
    row = (6 + 6 + 3 + 6 + 3) * (lane + agent) + 2 * (lane + agent)
    for most, held in ((7 * 2 * row, True), (7 * 2 * row - 1, False)):
        ahead = modulation_ahead(network, params, times, label, MASKS, most)
        assert (ahead(jnp.array([3, 3])) is not None) == held
    assert module.MAX_PRECOMPUTED * 4 == 128 * 2**20  # bytes, as its docstring says
