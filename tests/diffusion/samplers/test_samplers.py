"""What samplers must reach: known data, the moments and the flow of normal data, their orders, their noise."""

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
    dpm_solver,
    sampler_of,
    schedule_of,
)
from scjax.diffusion.samplers.base import SamplingContext
from scjax.diffusion.samplers.loop import scene_noise
from scjax.scene.per_type import PerType
from tests.factories.sampler_oracles import (
    CASES,
    EVEN,
    MOST,
    WIDTHS,
    drawn,
    knowing,
    levels_of,
    masks,
    network,
    normal,
    schedule,
)

KEYS = jax.random.split(jax.random.key(1), 400)
FULL = masks([(7, 9)] * 400)
FREE = {"temperature": EVEN, "clip": None}


@pytest.mark.parametrize("case", CASES)
def test_whoever_knows_the_data_is_led_to_it(case):
    clean = jax.tree.map(lambda n, width: jax.random.normal(jax.random.key(n), (4, n, width)), MOST, WIDTHS)
    clean = jax.tree.map(lambda x: jnp.clip(x, -1.9, 1.9), clean)
    found = drawn(case, knowing(clean, CASES[case][1]), KEYS[:4], masks([(7, 9)] * 4), steps=5)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=1e-3), found, clean)


@pytest.mark.parametrize("case", [name for name in CASES if name != "ddpm"])  # whose deviation test_loop.py knows
def test_normal_data_come_back_with_their_mean_and_deviation(case):
    """26,000 numbers: their mean and deviation are known to 0.0025. First order leaves 0.02 at 60 steps."""
    sampler, prediction = CASES[case]
    if isinstance(sampler, DPMSolver | DDIM):
        sampler = dataclasses.replace(sampler, threshold=None)
    found = drawn((sampler, prediction), normal(0.7, 0.4, prediction), KEYS, FULL, steps=60, **FREE)
    for leaf in jax.tree.leaves(found):
        np.testing.assert_allclose([leaf.mean(), leaf.std()], [0.7, 0.4], atol=0.015 if sampler.last < 1 else 0.03)


def test_ddim_of_eta_one_is_ancestral_sampling():
    """Same mean and same deviation in every step: with the same noise it is the same scene."""
    denoise = normal(0.7, 0.4, "velocity")
    ours, reference = (
        drawn((sampler, "velocity"), denoise, KEYS[:4], masks([(7, 9)] * 4), steps=100)
        for sampler in (DDIM(eta=1.0), DDPM())
    )
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=2e-4), ours, reference)


@pytest.mark.parametrize("eta", [0.3, 1.0])
def test_the_noise_of_ddim_is_eta_times_that_of_the_posterior(eta):
    """From one x, with noise and without: the difference is the noise drawn; its scale is that of the posterior."""
    levels = schedule(DDIM(), "noise", 100)
    ones = PerType(agents=jnp.ones((1, 2, 3)), lanes=jnp.ones((1, 2, 5)))

    def at(number, noise):
        step = jnp.int32(number)
        problem = SamplingContext(
            lambda x, step: jax.tree.map(lambda x: 0.3 * x, x), lambda step: jax.tree.map(lambda x: noise * x, ones),
            levels, "noise", masks([(2, 2)], 2, 2),
        )  # fmt: skip
        return DDIM(eta).step(problem, ones, step, ())[0].lanes[0, 0, 0]

    for step in (0, 1, 50, 99):
        found = at(step, 1.0) - at(step, 0.0)
        np.testing.assert_allclose(found, eta * posterior_std(levels, jnp.array([step]))[0], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("case", ["ddim", "dpm++", "dpm++, flow", "euler", "heun"])
def test_deterministic_samplers_draw_no_noise_after_the_start(case):
    sampler, prediction = CASES[case]
    denoise = normal(0.7, 0.4, prediction)
    x = PerType(agents=jnp.ones((1, 2, 3)), lanes=jnp.ones((1, 2, 5)))

    def refuse(step):
        raise AssertionError("noise was drawn")

    levels = schedule(sampler, prediction, 10)
    everything = jax.tree.map(lambda x: jnp.ones(x.shape[:2], bool), x)
    time = levels.levels.time[5:6]
    problem = SamplingContext(lambda x, step: denoise(x, jnp.asarray(time)), refuse, levels, prediction, everything)
    found, _ = sampler.step(problem, x, jnp.int32(5), sampler.begin(x))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))


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
def test_the_order_of_convergence(sampler, prediction, std, steps, order):
    """The probability flow of normal data takes x to mean + std (x - signal mean) / deviation of x, exactly."""
    mean, total = 0.7, 3200
    last = levels_of(prediction, total)[jnp.array(total - 1)]
    denoise, errors = normal(mean, std, prediction, total), []
    for count in steps:
        like = jax.tree.map(lambda n, width: jnp.zeros((20, n, width)), MOST, WIDTHS)
        start = scene_noise(KEYS[:20], max(count, 100), like, MOST)
        spread = np.sqrt(last.signal**2 * std**2 + last.noise**2)
        exact = jax.tree.map(lambda x, s=spread: mean + std * (x - last.signal * mean) / s, start)
        found = drawn((sampler, prediction), denoise, KEYS[:20], masks([(7, 9)] * 20), count, total, **FREE)
        errors.append(np.sqrt(np.mean(np.square(found.lanes - exact.lanes))))
    assert abs(np.log2(errors[0] / errors[1]) / 2 - order) < 0.25, errors


def test_the_first_and_the_last_step_of_dpm_solver_are_of_first_order():
    for prediction in ("velocity", "flow"):
        levels = schedule(DPMSolver(), prediction, 8).levels
        kept, new, further = dpm_solver.coefficients(levels)
        assert further[0] == further[-1] == 0 and (further[1:-2] > 0).all() and (kept[0], new[0]) == (0, 1)
        signal, noise, signal_after, noise_after = levels.host()  # any x_0 and eps stay on their path
        np.testing.assert_allclose(kept * signal + new, signal_after, atol=1e-12)
        np.testing.assert_allclose(kept * noise, noise_after, atol=1e-12)


@pytest.mark.parametrize("case", ["ddim", "dpm++", "ddpm"])
def test_an_error_of_the_noise_at_the_last_time_does_no_harm(case):
    """There abar is 2.4e-7: dividing by its root makes an error of 0.01 one of 20, and moves the mean by 0.7."""
    exact, sampler = normal(0.3, 0.5, "noise"), CASES[case][0]

    def off(z, t):
        return jax.tree.map(lambda x: x + 0.01, exact(z, t))

    few = {"keys": KEYS[:20], "mask": masks([(7, 9)] * 20), "steps": 4}
    found, wanted = (drawn((sampler, "noise"), denoise, **few) for denoise in (off, exact))
    assert float(jnp.abs(found.lanes - wanted.lanes).max()) < 0.1
    np.testing.assert_allclose([found.lanes.mean(), wanted.lanes.mean()], 0.3, atol=0.1)
    times = schedule(sampler, "noise", 4).timesteps
    assert times[-1] == 97 and schedule(sampler, "velocity", 4).timesteps[-1] == 99


def test_half_a_last_step_suits_second_order():
    """Normal data of deviation 0.4 in 10 steps, against a last step as long as the others."""
    errors = []
    for last in (DPMSolver.last, 1.0):

        class Shifted(DPMSolver):
            pass

        Shifted.last = last
        found = drawn((Shifted(None), "velocity"), normal(0.7, 0.4, "velocity"), KEYS, FULL, steps=10, **FREE)
        errors.append(abs(float(found.lanes.std()) - 0.4))
    assert errors[0] < 0.7 * errors[1], errors


def test_samplers_are_chosen_by_name_and_refused_with_those_that_fit():
    assert sampler_of(None, "velocity") == DDPM() and sampler_of(None, "flow") == Heun()
    assert sampler_of("dpm++", "flow") == DPMSolver() and sampler_of(DDIM(eta=1.0), "noise").eta == 1
    with pytest.raises(ValueError, match=r"no sampler 'magic': choose one of ddpm, ddim, dpm\+\+$"):
        sampler_of("magic", "noise")
    with pytest.raises(ValueError, match=r"'ddim' is for .* noise or velocity.*choose one of dpm\+\+, euler, heun"):
        sampler_of(DDIM(), "flow")
    with pytest.raises(ValueError, match=r"'heun' .* this model's estimates velocity: choose one of ddpm, ddim, dpm"):
        sampler_of("heun", "velocity")
    with pytest.raises(ValueError, match="eta"):
        DDIM(eta=1.5)


def test_networks_disagree_where_they_should():
    """The oracles are no tautology: a wrong one leads elsewhere."""
    wrong = network(lambda signal, noise, x, name: 0 * x - 1.0, "flow")
    found = drawn("heun", wrong, KEYS[:2], masks([(7, 9)] * 2), steps=5)
    np.testing.assert_allclose(found.lanes, -1.0, atol=1e-4)


def test_every_sampler_that_fits_a_prediction_has_a_number_of_steps():
    assert {name: set(steps) for name, steps in DEFAULT_STEPS.items()} == {
        prediction: {name for name, one in SAMPLERS.items() if prediction in one.predictions}
        for prediction in DEFAULT_STEPS
    }
    for prediction, steps in DEFAULT_STEPS.items():
        for name, count in steps.items():
            assert schedule_of(SAMPLERS[name], prediction).steps == count
    assert DEFAULT_STEPS["noise"]["ddpm"] == 100  # what the release does
