"""Energy guidance: x0 estimates descend an energy at low noise; known tokens and noisy steps stay unchanged."""

from __future__ import annotations

import dataclasses
import json

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.defaults import DEFAULT_ENERGIES
from scjax.diffusion.energy_guidance import EnergyGuidance, gradient_steps_per_level, with_energy_guidance
from scjax.diffusion.samplers import make_schedule
from scjax.scene.per_type import PerType
from tests.factories.sampler_oracles import (
    LATENT_WIDTHS,
    SAMPLER_CASES,
    gaussian_denoiser,
    point_denoiser,
    sample_case,
    token_masks,
)

KEYS = jax.random.split(jax.random.key(3), 2)
SIZES = [(3, 4), (7, 9)]
MINIMUM = 0.25


def parabola(minimum):
    """Half the squared distance of all latents from ``minimum``, the same energy around every estimate."""
    return lambda start: lambda x: 0.5 * sum(jnp.square(leaf - minimum).sum() for leaf in (x.agents, x.lanes))


def case_levels(case, steps):
    sampler, prediction = SAMPLER_CASES[case]
    return make_schedule(sampler, prediction, steps).levels


def ones_denoiser(masks, prediction="velocity"):
    """A denoiser whose x0 estimate is 1."""
    clean = jax.tree.map(lambda m, width: jnp.ones((*m.shape, width)), masks, LATENT_WIDTHS)
    return point_denoiser(clean, prediction)


def test_gradient_steps_are_spread_over_the_last_steps():
    levels = case_levels("ddpm", 16)
    counts = gradient_steps_per_level(EnergyGuidance(gradient_steps=18, max_sigma=0.35), levels)
    assert counts.tolist() == [6, 6, 6] + [0] * 13 and levels.sigma[2] < 0.35 < levels.sigma[3]
    counts = gradient_steps_per_level(EnergyGuidance(gradient_steps=5, max_sigma=0.0), levels)
    assert counts.tolist() == [5] + [0] * 15
    counts = gradient_steps_per_level(EnergyGuidance(gradient_steps=7, max_sigma=0.35), levels)
    assert counts[:4].tolist() == [4, 0, 4, 0]


def test_a_guided_step_has_enough_gradient_steps_for_momentum():
    levels = case_levels("ddpm", 100)
    counts = gradient_steps_per_level(EnergyGuidance(gradient_steps=8, max_sigma=0.2), levels)
    assert levels.sigma[11] < 0.2 < levels.sigma[12]
    assert counts.nonzero()[0].tolist() == [0, 11] and set(counts[[0, 11]]) == {4}
    counts = gradient_steps_per_level(EnergyGuidance(gradient_steps=3, max_sigma=1.0), levels)
    assert counts.tolist() == [3] + [0] * 99


@pytest.mark.parametrize("case", [name for name in SAMPLER_CASES if "dynamic" not in name])
def test_every_sampler_ends_at_the_guided_estimate(case):
    """The x0 estimate is 1. One gradient step in the last step moves it half of the way to the minimum."""
    masks, prediction = token_masks(SIZES), SAMPLER_CASES[case][1]
    options = EnergyGuidance(gradient_steps=1, max_sigma=0.0, agent_step_size=0.5, lane_step_size=0.5)
    denoise = with_energy_guidance(
        ones_denoiser(masks, prediction), case_levels(case, 6), prediction, parabola(MINIMUM), masks, options
    )
    x = sample_case(case, denoise, KEYS, masks, steps=6)
    expected = 1 - 0.5 * (1 - MINIMUM)
    for name in ("agents", "lanes"):
        np.testing.assert_allclose(getattr(x, name)[getattr(masks, name)], expected, atol=1e-4)


def test_steps_without_gradient_steps_are_unchanged():
    plain, levels, masks = gaussian_denoiser(0.5, 0.4, "velocity"), case_levels("ddpm", 16), token_masks(SIZES)
    options = EnergyGuidance(max_sigma=0.35, agent_step_size=0.1, lane_step_size=0.1)
    guided = jax.jit(with_energy_guidance(plain, levels, "velocity", parabola(MINIMUM), masks, options))
    counts = gradient_steps_per_level(options, levels)
    assert counts.nonzero()[0].tolist() == [0, 2]
    z = PerType(agents=jnp.ones((2, 7, 3)), lanes=jnp.ones((2, 9, 5)))
    for step in range(16):
        t = jnp.broadcast_to(jnp.asarray(levels.time)[step], (2,))
        outputs = (jax.tree.leaves(denoise(z, t)) for denoise in (guided, jax.jit(plain)))
        same = [np.array_equal(a, b) for a, b in zip(*outputs, strict=True)]
        assert not any(same) if counts[step] else all(same)


def test_momentum_carries_over_between_gradient_steps():
    """Two Nesterov steps by hand, from 1 towards 0."""
    masks = token_masks(SIZES)
    options = EnergyGuidance(gradient_steps=2, max_sigma=0.0, momentum=0.5, agent_step_size=0.1, lane_step_size=0.1)
    denoise = with_energy_guidance(
        ones_denoiser(masks), case_levels("ddpm", 6), "velocity", parabola(0.0), masks, options
    )
    x, velocity = 1.0, 0.0
    for _ in range(2):
        velocity = 0.5 * velocity - 0.1 * (x + 0.5 * velocity)
        x += velocity
    samples = sample_case("ddpm", denoise, KEYS, masks, steps=6)
    np.testing.assert_allclose(samples.lanes[masks.lanes], x, atol=1e-4)


def test_the_energy_is_built_around_the_estimate_of_each_step():
    """An energy with its minimum at the estimate does not move it."""
    masks = token_masks(SIZES)
    options = EnergyGuidance(agent_step_size=0.5, lane_step_size=0.2)
    denoise = with_energy_guidance(
        ones_denoiser(masks),
        case_levels("ddpm", 6),
        "velocity",
        lambda start: lambda x: jnp.square(x.lanes - start.lanes).sum(),
        masks,
        options,
    )
    samples = sample_case("ddpm", denoise, KEYS, masks, steps=6)
    np.testing.assert_allclose(samples.lanes[masks.lanes], 1.0, atol=1e-4)


def test_known_tokens_enter_the_energy_clean_and_do_not_move():
    """The energy pulls agent 1 to agent 0, which is known: it counts with its clean latents and stays."""
    masks = token_masks([(3, 4)])
    generated = masks.replace(agents=masks.agents.at[:, 0].set(False))

    def attraction(start):
        return lambda x: 0.5 * jnp.square(x.agents[:, 1] - x.agents[:, 0]).sum()

    levels = case_levels("ddpm", 16)
    zeros = PerType(agents=jnp.zeros((1, 7, 3)), lanes=jnp.zeros((1, 9, 5)))
    options = EnergyGuidance(gradient_steps=60, max_sigma=0.35, momentum=0.0, agent_step_size=0.3, lane_step_size=0.3)
    denoise = with_energy_guidance(
        point_denoiser(zeros, "velocity"), levels, "velocity", attraction, generated, options
    )
    z = PerType(agents=jnp.full((1, 7, 3), 2.0), lanes=jnp.zeros((1, 9, 5)))
    level = levels[jnp.zeros(1, int)]
    output = denoise(z, jnp.asarray(level.time))
    x0 = level.alpha[:, None, None] * z.agents - level.sigma[:, None, None] * output.agents
    np.testing.assert_allclose(x0[:, 0], 2.0, atol=1e-5)
    np.testing.assert_allclose(x0[:, 1], 2.0, atol=1e-2)
    np.testing.assert_allclose(x0[:, 2], 0.0, atol=1e-5)


def test_guided_scenes_are_independent_of_their_batch():
    plain = gaussian_denoiser(0.5, 0.4, "velocity")
    options = EnergyGuidance(agent_step_size=0.2, lane_step_size=0.2)

    def run(keys, masks):
        denoise = with_energy_guidance(plain, case_levels("ddpm", 8), "velocity", parabola(MINIMUM), masks, options)
        return sample_case("ddpm", denoise, keys, masks, steps=8)

    both, one = run(KEYS, token_masks(SIZES)), run(KEYS[:1], token_masks(SIZES[:1]))
    chex.assert_trees_all_close(jax.tree.map(lambda x: x[:1], both), one, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gradient_steps": 0}, "gradient_steps"),
        ({"max_sigma": 1.5}, "max_sigma"),
        ({"momentum": 1.0}, "momentum"),
        ({"agent_step_size": -1.0}, "agent_step_size"),
        ({"lane_step_size": np.nan}, "lane_step_size"),
        ({"energies": ()}, "energies is empty"),
        ({"energies": (("magic", 1.0),)}, "'magic': choose from connections, overlap, off_lane"),
        ({"energies": (("overlap", -1.0),)}, "'overlap' the weight -1"),
    ],
)
def test_invalid_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        EnergyGuidance(**options)


@pytest.mark.parametrize("energies", [DEFAULT_ENERGIES, (("overlap", 2.0),)])
def test_options_survive_json(energies):
    options = EnergyGuidance(gradient_steps=3, energies=energies)
    restored = EnergyGuidance.from_dict(json.loads(json.dumps(dataclasses.asdict(options))))
    assert restored == options and hash(restored) == hash(options)


def test_saved_options_without_energies_use_the_default():
    assert EnergyGuidance.from_dict({"gradient_steps": 3}).energies == DEFAULT_ENERGIES
