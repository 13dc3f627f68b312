"""The sampling loop with simple denoisers: noise, padding, known tokens, temperature, and DDPM in closed form."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.defaults import DEFAULT_LATENT_BOUND
from scjax.diffusion.samplers.loop import sample_latents, scene_noise, set_known
from scjax.diffusion.schedule import cosine_schedule, respace
from scjax.scene.per_type import PerType
from tests.factories.sampler_oracles import (
    LATENT_WIDTHS,
    MAX_TOKENS,
    SAMPLER_CASES,
    UNIT_TEMPERATURE,
    sample_case,
    token_masks,
)

KEYS = jax.random.split(jax.random.key(0), 6)
SCHEDULE = cosine_schedule()


def zeros(batch, agents, lanes):
    return PerType(agents=jnp.zeros((batch, agents, 3)), lanes=jnp.zeros((batch, lanes, 5)))


def tanh_denoise(z, t):
    """An elementwise estimate: scenes and tokens cannot mix."""
    return jax.tree.map(lambda x: jnp.tanh(x) * (1 + t[:, None, None] / 100), z)


def zero_denoise(z, t):
    return jax.tree.map(jnp.zeros_like, z)


@jax.jit
def noise_of_step_17(keys, like):
    return scene_noise(keys, 17, like, MAX_TOKENS)


def test_noise_is_the_same_in_any_batch_and_padding():
    whole = noise_of_step_17(KEYS, zeros(6, 7, 9))
    for rows, (agents, lanes) in ((slice(0, 1), (7, 9)), (slice(2, 5), (4, 3)), (slice(1, 6), (1, 8))):
        part = noise_of_step_17(KEYS[rows], zeros(len(range(6)[rows]), agents, lanes))
        np.testing.assert_array_equal(part.agents, whole.agents[rows, :agents])
        np.testing.assert_array_equal(part.lanes, whole.lanes[rows, :lanes])


def test_noise_differs_between_scenes_steps_and_types():
    like = PerType(agents=jnp.zeros((2, 7, 5)), lanes=jnp.zeros((2, 7, 5)))
    max_tokens = PerType(agents=7, lanes=7)
    first, second = (scene_noise(KEYS[:2], step, like, max_tokens) for step in (0, 1))
    samples = [first.agents[0], first.agents[1], first.lanes[0], first.lanes[1], second.agents[0], second.lanes[1]]
    assert len({np.asarray(x).tobytes() for x in samples}) == len(samples)


def test_too_many_tokens_are_refused():
    with pytest.raises(ValueError, match="8 tokens"):
        scene_noise(KEYS, 0, zeros(6, 8, 9), MAX_TOKENS)


@pytest.fixture(scope="module", params=SAMPLER_CASES)
def batch(request):
    """Case, sizes, known tokens, their latents, and the samples of one padded batch: the first scene knows nothing."""
    sizes = [(3, 4), (7, 9), (1, 1), (3, 4)]
    masks, rng = token_masks(sizes, 7, 9), np.random.default_rng(0)
    known = jax.tree.map(lambda mask: np.array(mask & (rng.random(mask.shape) < 0.5)), masks)
    known.agents[0], known.lanes[0] = False, False
    known.lanes[1] = masks.lanes[1]  # lane-conditioned
    latents = jax.tree.map(lambda mask, width: 7 * rng.normal(size=(*mask.shape, width)), known, LATENT_WIDTHS)
    known_latents = jax.tree.map(lambda mask, x: np.where(mask[..., None], x, np.nan).astype("f4"), known, latents)
    options = {"steps": 6, "known": known, "known_latents": known_latents}
    samples = sample_case(request.param, tanh_denoise, KEYS[:4], masks, **options)
    return request.param, sizes, known, known_latents, samples


def test_samples_do_not_depend_on_batch_and_padding(batch):
    """Nor on what other scenes know: the scene alone is sampled without known tokens."""
    case, sizes, known, _, whole = batch
    agents, lanes = sizes[0]
    alone = sample_case(case, tanh_denoise, KEYS[:1], token_masks(sizes[:1], agents, lanes), steps=6)
    np.testing.assert_allclose(alone.agents[0], whole.agents[0, :agents], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(alone.lanes[0], whole.lanes[0, :lanes], rtol=1e-5, atol=1e-5)
    assert not np.any(whole.agents[0, agents:]) and not np.any(whole.lanes[0, lanes:])
    largest = jax.tree.map(lambda x, flags: np.abs(np.asarray(x)[~flags]).max(), whole, known)
    assert max(largest.agents, largest.lanes) <= DEFAULT_LATENT_BOUND


def test_known_tokens_stay_bit_for_bit(batch):
    _, _, known, known_latents, samples = batch
    for name in ("agents", "lanes"):
        mask = getattr(known, name)
        assert mask[1:].any()
        np.testing.assert_array_equal(np.asarray(getattr(samples, name))[mask], getattr(known_latents, name)[mask])
        assert np.isfinite(getattr(samples, name)).all()


def test_known_tokens_need_their_latents():
    masks = token_masks([(3, 4)])
    with pytest.raises(ValueError, match="known_latents"):
        set_known(zeros(1, 7, 9), masks, None)


@pytest.mark.parametrize("steps", [100, 25])
def test_ddpm_on_a_gaussian_follows_its_closed_form(steps):
    """x0 ~ N(m, s^2): the optimal estimate is linear, so the mean and variance of every step have a closed form.

    The end is close to m and s but narrower: the posterior variance is the lower bound of Ho et al. 2020.
    """
    mean, std, scenes = 0.7, 0.4, 400
    schedule = respace(SCHEDULE, steps)

    def gain(alphas_cumprod):
        """The optimal noise estimate is gain * (x - sqrt(alphas_cumprod) m)."""
        return (1 - alphas_cumprod) ** 0.5 / (alphas_cumprod * std**2 + 1 - alphas_cumprod)

    expected_mean, variance = 0.0, 1.0
    for i in range(steps - 1, -1, -1):
        cumprod = np.float64(schedule.alphas_cumprod[i])
        a, b = (np.float64(getattr(schedule, f"sqrt_recip{m}_alphas_cumprod")[i]) for m in ("", "m1"))
        c, d = (np.float64(getattr(schedule, f"posterior_mean_coef{n}")[i]) for n in (1, 2))
        factor = c * (a - b * gain(cumprod)) + d
        expected_mean = factor * expected_mean + c * b * gain(cumprod) * np.sqrt(cumprod) * mean
        variance = factor**2 * variance + (schedule.posterior_variance[i] if i else 0)
    assert abs(expected_mean - mean) < 0.01 and abs(np.sqrt(variance) - std) < 0.1

    def denoise(z, t):
        cumprod = jnp.asarray(SCHEDULE.alphas_cumprod)[t][:, None, None]
        return jax.tree.map(lambda x: gain(cumprod) * (x - jnp.sqrt(cumprod) * mean), z)

    keys, masks = jax.random.split(jax.random.key(1), scenes), token_masks([(7, 9)] * scenes, 7, 9)
    samples = jax.jit(
        lambda: sample_latents(
            denoise,
            schedule,
            keys,
            masks,
            latent_widths=LATENT_WIDTHS,
            max_tokens=MAX_TOKENS,
            temperature=UNIT_TEMPERATURE,
            clip=None,
        )
    )()
    for leaf in jax.tree.leaves(samples):
        np.testing.assert_allclose(leaf.mean(), expected_mean, atol=0.015)
        np.testing.assert_allclose(leaf.std(), np.sqrt(variance), rtol=0.02)


def test_the_start_is_the_same_for_any_number_of_steps():
    """With velocity zero the end is the start."""
    masks = token_masks([(7, 9)] * 6, 7, 9)
    ends = [sample_case("euler", zero_denoise, KEYS, masks, steps) for steps in (3, 7)]
    jax.tree.map(np.testing.assert_array_equal, *ends)
    assert 0.9 < ends[0].agents.std() < 1.1


def test_temperature_scales_the_noise_per_type():
    """With a noise estimate of zero only the random noise moves the state."""
    masks = token_masks([(7, 9)] * 6, 7, 9)
    samples = jax.jit(
        lambda: sample_latents(
            zero_denoise,
            respace(SCHEDULE, 2),
            KEYS,
            masks,
            latent_widths=LATENT_WIDTHS,
            max_tokens=MAX_TOKENS,
            temperature=PerType(agents=1.0, lanes=0.0),
        )
    )()
    assert np.any(samples.agents) and not np.any(samples.lanes)
