"""Samplers on exact denoisers: known data, moments and flow of Gaussian data, orders of convergence, noise."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.process import posterior_std
from scjax.diffusion.samplers import (
    DDIM,
    DDPM,
    DEFAULT_STEPS,
    SAMPLERS,
    DPMSolver,
    Euler,
    Heun,
    make_schedule,
    resolve_sampler,
)
from scjax.diffusion.samplers.base import SamplingContext
from scjax.diffusion.samplers.dpm_solver import multistep_coefficients
from scjax.diffusion.samplers.loop import scene_noise
from scjax.scene.per_type import PerType
from tests.factories.sampler_oracles import (
    LATENT_WIDTHS,
    MAX_TOKENS,
    SAMPLER_CASES,
    UNIT_TEMPERATURE,
    denoiser_from_x0,
    gaussian_denoiser,
    point_denoiser,
    sample_case,
    schedule_for,
    token_masks,
    training_levels,
)

KEYS = jax.random.split(jax.random.key(1), 400)
FULL = token_masks([(7, 9)] * 400)
UNBOUNDED = {"temperature": UNIT_TEMPERATURE, "clip": None}


@pytest.mark.parametrize("case", SAMPLER_CASES)
def test_the_exact_denoiser_of_a_point_leads_to_it(case):
    clean = jax.tree.map(
        lambda n, width: jax.random.normal(jax.random.key(n), (4, n, width)), MAX_TOKENS, LATENT_WIDTHS
    )
    clean = jax.tree.map(lambda x: jnp.clip(x, -1.9, 1.9), clean)
    denoise = point_denoiser(clean, SAMPLER_CASES[case][1])
    samples = sample_case(case, denoise, KEYS[:4], token_masks([(7, 9)] * 4), steps=5)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-3), samples, clean)


@pytest.mark.parametrize("case", [name for name in SAMPLER_CASES if name != "ddpm"])  # test_loop.py checks ddpm
def test_gaussian_data_keep_their_mean_and_deviation(case):
    """26,000 numbers determine mean and deviation to 0.0025. First order leaves an error of 0.02 at 60 steps."""
    sampler, prediction = SAMPLER_CASES[case]
    if isinstance(sampler, DPMSolver | DDIM):
        sampler = dataclasses.replace(sampler, threshold=None)
    denoise = gaussian_denoiser(0.7, 0.4, prediction)
    samples = sample_case((sampler, prediction), denoise, KEYS, FULL, steps=60, **UNBOUNDED)
    tolerance = 0.015 if sampler.last_step < 1 else 0.03
    for leaf in jax.tree.leaves(samples):
        np.testing.assert_allclose([leaf.mean(), leaf.std()], [0.7, 0.4], atol=tolerance)


def test_ddim_with_eta_one_is_ancestral_sampling():
    """Mean and deviation of every step are equal, so the same noise gives the same scene."""
    denoise = gaussian_denoiser(0.7, 0.4, "velocity")
    ddim, ddpm = (
        sample_case((sampler, "velocity"), denoise, KEYS[:4], token_masks([(7, 9)] * 4), steps=100)
        for sampler in (DDIM(eta=1.0), DDPM())
    )
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=2e-4), ddim, ddpm)


@pytest.mark.parametrize("eta", [0.3, 1.0])
def test_ddim_noise_is_eta_times_the_posterior_std(eta):
    """The difference of one step with and without noise is the noise that DDIM adds."""
    schedule = schedule_for(DDIM(), "noise", 100)
    ones = PerType(agents=jnp.ones((1, 2, 3)), lanes=jnp.ones((1, 2, 5)))
    half = jax.tree.map(lambda x: 0.5 * x, ones)

    def step_result(step, noise):
        context = SamplingContext(
            step_noise=lambda step: jax.tree.map(lambda x: noise * x, ones),
            schedule=schedule,
            generated=token_masks([(2, 2)], 2, 2),
        )
        return DDIM(eta).step(context, ones, half, jnp.int32(step), ())[0].lanes[0, 0, 0]

    for step in (0, 1, 50, 99):
        noise = step_result(step, 1.0) - step_result(step, 0.0)
        np.testing.assert_allclose(noise, eta * posterior_std(schedule, jnp.array([step]))[0], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("case", ["ddim", "dpm++", "dpm++, flow", "euler", "heun"])
def test_deterministic_samplers_add_no_noise(case):
    sampler, prediction = SAMPLER_CASES[case]
    x = PerType(agents=jnp.ones((1, 2, 3)), lanes=jnp.ones((1, 2, 5)))

    def refuse(step):
        raise AssertionError("noise was drawn")

    everything = jax.tree.map(lambda x: jnp.ones(x.shape[:2], bool), x)
    context = SamplingContext(refuse, schedule_for(sampler, prediction, 10), everything)
    x0 = jax.tree.map(lambda x: 0.7 * x, x)
    result, _ = sampler.step(context, x, x0, jnp.int32(5), sampler.init_memory(x))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(result))


@pytest.mark.parametrize(
    ("sampler", "prediction", "std", "steps", "order"),
    [
        (DDIM(threshold=None), "velocity", 0.5, (50, 200), 1),
        (DPMSolver(threshold=None), "velocity", 0.5, (50, 200), 2),
        (DPMSolver(threshold=None), "flow", 0.5, (50, 200), 2),
        (Euler(), "flow", 1.5, (50, 200), 1),
        (Heun(), "flow", 1.5, (25, 100), 2),
    ],
)
def test_order_of_convergence(sampler, prediction, std, steps, order):
    """The exact probability flow of Gaussian data maps x to mean + std (x - alpha mean) / deviation of x."""
    mean, total = 0.7, 3200
    noisiest = training_levels(prediction, total)[jnp.array(total - 1)]
    denoise, errors = gaussian_denoiser(mean, std, prediction, total), []
    deviation = np.sqrt(noisiest.alpha**2 * std**2 + noisiest.sigma**2)
    masks = token_masks([(7, 9)] * 20)
    for count in steps:
        like = jax.tree.map(lambda n, width: jnp.zeros((20, n, width)), MAX_TOKENS, LATENT_WIDTHS)
        start = scene_noise(KEYS[:20], max(count, 100), like, MAX_TOKENS)
        exact = jax.tree.map(lambda x: mean + std * (x - noisiest.alpha * mean) / deviation, start)
        samples = sample_case((sampler, prediction), denoise, KEYS[:20], masks, count, total, **UNBOUNDED)
        errors.append(np.sqrt(np.mean(np.square(samples.lanes - exact.lanes))))
    assert abs(np.log2(errors[0] / errors[1]) / 2 - order) < 0.25, errors


@pytest.mark.parametrize("prediction", ["velocity", "flow"])
def test_dpm_solver_starts_and_ends_with_first_order(prediction):
    levels = schedule_for(DPMSolver(), prediction, 8).levels
    coefficients = multistep_coefficients(levels)
    difference = coefficients.difference
    assert difference[0] == difference[-1] == 0 and (difference[1:-2] > 0).all()
    assert (coefficients.x[0], coefficients.x0[0]) == (0, 1)


@pytest.mark.parametrize("prediction", ["velocity", "flow"])
def test_dpm_solver_keeps_any_x0_and_noise_on_their_path(prediction):
    levels = schedule_for(DPMSolver(), prediction, 8).levels
    coefficients, transitions = multistep_coefficients(levels), levels.transitions()
    next_alpha = coefficients.x * transitions.alpha + coefficients.x0
    np.testing.assert_allclose(next_alpha, transitions.next_alpha, atol=1e-12)
    np.testing.assert_allclose(coefficients.x * transitions.sigma, transitions.next_sigma, atol=1e-12)


@pytest.mark.parametrize("case", ["ddim", "dpm++", "ddpm"])
def test_noise_errors_at_the_last_timestep_do_no_harm(case):
    """There alphas_cumprod is 2.4e-7: dividing by its root turns an error of 0.01 into 20 and moves the mean by 0.7."""
    exact, sampler = gaussian_denoiser(0.3, 0.5, "noise"), SAMPLER_CASES[case][0]

    def inexact(z, t):
        return jax.tree.map(lambda x: x + 0.01, exact(z, t))

    options = {"keys": KEYS[:20], "masks": token_masks([(7, 9)] * 20), "steps": 4}
    shifted, reference = (sample_case((sampler, "noise"), denoise, **options) for denoise in (inexact, exact))
    assert float(jnp.abs(shifted.lanes - reference.lanes).max()) < 0.1
    np.testing.assert_allclose([shifted.lanes.mean(), reference.lanes.mean()], 0.3, atol=0.1)
    timesteps = schedule_for(sampler, "noise", 4).timesteps
    assert timesteps[-1] == 97 and schedule_for(sampler, "velocity", 4).timesteps[-1] == 99


def test_half_a_last_step_suits_second_order():
    """Gaussian data of deviation 0.4 in 10 steps, against a last step as long as the others."""

    class FullLastStep(DPMSolver):
        last_step = 1.0

    errors = []
    for sampler in (DPMSolver(None), FullLastStep(None)):
        denoise = gaussian_denoiser(0.7, 0.4, "velocity")
        samples = sample_case((sampler, "velocity"), denoise, KEYS, FULL, steps=10, **UNBOUNDED)
        errors.append(abs(float(samples.lanes.std()) - 0.4))
    assert errors[0] < 0.7 * errors[1], errors


def test_samplers_are_resolved_by_name_or_default():
    assert resolve_sampler(None, "velocity") == DDPM() and resolve_sampler(None, "flow") == Heun()
    assert resolve_sampler("dpm++", "flow") == DPMSolver() and resolve_sampler(DDIM(eta=1.0), "noise").eta == 1


@pytest.mark.parametrize(
    ("sampler", "prediction", "message"),
    [
        ("magic", "noise", r"no sampler 'magic': choose one of ddpm, ddim, dpm\+\+$"),
        (DDIM(), "flow", r"'ddim' is for .* noise or velocity.*choose one of dpm\+\+, euler, heun"),
        ("heun", "velocity", r"'heun' .* this model's estimates velocity: choose one of ddpm, ddim, dpm"),
    ],
)
def test_unsuitable_samplers_are_refused(sampler, prediction, message):
    with pytest.raises(ValueError, match=message):
        resolve_sampler(sampler, prediction)


def test_ddim_refuses_eta_above_one():
    with pytest.raises(ValueError, match="eta"):
        DDIM(eta=1.5)


def test_a_wrong_denoiser_leads_elsewhere():
    """The exact denoisers of these tests are no tautology."""
    wrong = denoiser_from_x0(lambda alpha, sigma, x, name: 0 * x - 1.0, "flow")
    samples = sample_case("heun", wrong, KEYS[:2], token_masks([(7, 9)] * 2), steps=5)
    np.testing.assert_allclose(samples.lanes, -1.0, atol=1e-4)


def test_every_sampler_has_default_steps_for_its_predictions():
    assert {prediction: set(steps) for prediction, steps in DEFAULT_STEPS.items()} == {
        "noise": {"ddpm", "ddim", "dpm++"},
        "velocity": {"ddpm", "ddim", "dpm++"},
        "flow": {"dpm++", "euler", "heun"},
    }
    for prediction, steps in DEFAULT_STEPS.items():
        for name, count in steps.items():
            assert make_schedule(SAMPLERS[name], prediction).steps == count
    assert DEFAULT_STEPS["noise"]["ddpm"] == 100  # as in the official release
