"""Self-conditioning: a fresh network ignores the estimate, an absent one is ignored always, samplers pass it on."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np

from scjax.diffusion.guidance import with_guidance
from scjax.diffusion.loss import LatentBatch, training_loss
from scjax.diffusion.samplers.loop import sample_latents
from scjax.diffusion.schedule import cosine_schedule, respace
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.estimate_features import SelfCondition
from scjax.models.denoiser.model import denoiser
from scjax.nn.functional import flatten, unflatten
from scjax.scene.per_type import PerType
from tests.factories import golden
from tests.factories.sampler_oracles import LATENT_WIDTHS, MAX_TOKENS, UNIT_TEMPERATURE, token_masks

CONFIG = DenoiserConfig(
    lane_width=16,
    lane_heads=2,
    agent_width=8,
    agent_heads=2,
    blocks=1,
    mlp_ratio=2,
    lane_latent=5,
    agent_latent=3,
    max_lanes=9,
    max_agents=7,
    fourier_features=2,
    relative_geometry=True,
    self_conditioning=True,
    prediction="velocity",
)
NETWORK = denoiser(CONFIG)
MASKS = token_masks([(4, 6), (2, 9)])
TIME, LABEL = jnp.array([3, 70]), jnp.array([0, 5])


def random_latents(seed):
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda m, w: rng.normal(size=(*m.shape, w)).astype(np.float32), MASKS, LATENT_WIDTHS)


@functools.cache
def params(fresh: bool):
    """Random parameters; ``fresh``: those of self-conditioning as at the start of a training."""
    rng, leaves = np.random.default_rng(0), flatten(NETWORK.init(jax.random.key(0)))
    stirred = {path: leaf + 0.3 * rng.normal(size=leaf.shape).astype(np.float32) for path, leaf in leaves.items()}
    own = {path: leaf for path, leaf in leaves.items() if path[0] == "estimate_features"} if fresh else {}
    return unflatten({**stirred, **own})


_apply = golden.jit(lambda params, z, estimate: NETWORK.apply(params, z, TIME, LABEL, MASKS, estimate=estimate))


def apply(fresh, latents=None, present=(True, True)):
    estimate = None if latents is None else SelfCondition(latents=latents, present=jnp.asarray(present))
    return jax.tree.leaves(_apply(params(fresh), random_latents(0), estimate))


def test_fresh_network_ignores_the_estimate():
    for with_estimate, without in zip(apply(True, random_latents(1)), apply(True), strict=True):
        np.testing.assert_allclose(with_estimate, without, rtol=1e-5, atol=1e-5)


def test_absent_estimates_and_padding_are_ignored():
    """Scene 0 has no estimate and NaN in its place, scene 1 has NaN at padding."""
    latents = random_latents(1)
    spoilt = jax.tree.map(
        lambda x, mask: np.where((np.asarray(mask) & np.array([[False], [True]]))[..., None], x, np.nan), latents, MASKS
    )
    outputs = apply(False, spoilt, (False, True))
    for output, without, both in zip(outputs, apply(False), apply(False, latents), strict=True):
        np.testing.assert_allclose(output[0], without[0], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(output[1], both[1], rtol=1e-5, atol=1e-5)
        assert np.abs(output[1] - without[1]).max() > 1e-2


def test_sampler_passes_the_last_estimate_on():
    """Each estimate is one more than the last, from 0: six evaluations end at 5."""
    schedule = respace(cosine_schedule(), 6)
    levels = schedule.levels

    def denoise(z, t, estimate):
        level = levels[jnp.searchsorted(jnp.asarray(levels.time), t)]
        alpha, sigma = level.alpha[:, None, None], level.sigma[:, None, None]
        present = estimate.present[:, None, None]
        return jax.tree.map(lambda x, last: (alpha * x - jnp.where(present, last + 1, 0)) / sigma, z, estimate.latents)

    @jax.jit
    def sample(keys):
        return sample_latents(
            denoise,
            schedule,
            keys,
            MASKS,
            prediction="velocity",
            latent_widths=LATENT_WIDTHS,
            max_tokens=MAX_TOKENS,
            temperature=UNIT_TEMPERATURE,
            self_conditioning=True,
        )

    samples = sample(jax.random.split(jax.random.key(0)))
    for kind in ("agents", "lanes"):
        np.testing.assert_allclose(getattr(samples, kind)[np.asarray(getattr(MASKS, kind))], 5, atol=1e-3)


def test_guidance_gives_both_branches_the_estimate():
    estimate = SelfCondition(latents=random_latents(1), present=jnp.array([True, False]))

    def denoise_both(z, t, both):
        np.testing.assert_array_equal(both.present, [True, False, True, False])
        return both.latents

    guided = with_guidance(denoise_both, 3.0)(random_latents(0), TIME, estimate)
    np.testing.assert_allclose(guided.lanes, estimate.latents.lanes, rtol=1e-5)


def test_loss_of_a_fresh_network_is_that_without_self_conditioning():
    """And self-conditioning gets a gradient, while half of the scenes go without."""
    batch = LatentBatch(
        latents=random_latents(2),
        masks=MASKS,
        known=PerType(agents=MASKS.agents & False, lanes=MASKS.lanes & (np.arange(9) < 1)[None]),
        label=LABEL,
    )

    @functools.partial(golden.jit, static_argnums=2)
    def evaluate(params, key, self_conditioning):
        def loss(params):
            options = {"null_label": CONFIG.null_label, "prediction": "velocity"}
            return training_loss(
                NETWORK, params, cosine_schedule(), batch, key, self_conditioning=self_conditioning, **options
            )[0]

        return jax.value_and_grad(loss)(params)

    largest = []
    for seed in range(3):
        keys = jax.random.split(jax.random.key(seed))
        (plain, _), (loss, gradient) = (evaluate(params(True), keys, flag) for flag in (False, True))
        np.testing.assert_allclose(loss, plain, rtol=1e-5)
        largest.append(np.abs(gradient["estimate_features"]["lanes"]["kernel"]).max())
    assert max(largest) > 1e-6
