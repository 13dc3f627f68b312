"""Steering: estimates descend an energy at low noise, given tokens and the noisy steps stay as they are."""

from __future__ import annotations

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.energy_guidance import EnergyGuidance, rounds_of, with_energy_guidance
from scjax.diffusion.samplers import schedule_of
from scjax.scene.per_type import PerType
from tests.factories.sampler_oracles import CASES, drawn, knowing, masks, normal

KEYS = jax.random.split(jax.random.key(3), 2)
SIZES = [(3, 4), (7, 9)]
WANTED = 0.25


def energy(*_):
    """Half the squared distance of all latents from ``WANTED``, wherever one is."""
    return lambda x: 0.5 * sum(jnp.square(leaf - WANTED).sum() for leaf in (x.agents, x.lanes))


def levels(case, steps):
    sampler, prediction = CASES[case]
    return schedule_of(sampler, prediction, steps).levels


def test_rounds_are_spread_over_the_last_steps():
    schedule = levels("ddpm", 16)
    rounds = rounds_of(18, 0.35, schedule)
    assert rounds.tolist() == [6, 6, 6] + [0] * 13 and schedule.noise[2] < 0.35 < schedule.noise[3]
    assert rounds_of(5, 0.0, schedule).tolist() == [5] + [0] * 15
    assert rounds_of(7, 0.35, schedule)[:4].tolist() == [4, 0, 4, 0]


def test_a_steered_step_has_enough_rounds_for_momentum():
    schedule = levels("ddpm", 100)
    rounds = rounds_of(8, 0.2, schedule)
    assert schedule.noise[11] < 0.2 < schedule.noise[12]
    assert rounds.nonzero()[0].tolist() == [0, 11] and set(rounds[[0, 11]]) == {4}
    assert rounds_of(3, 1.0, schedule).tolist() == [3] + [0] * 99


@pytest.mark.parametrize("case", [name for name in CASES if "dynamic" not in name])
def test_every_sampler_ends_where_its_estimate_was_led(case):
    """A network that knows x_0 = 1, one round of half the way to WANTED in the last step: all end in the middle."""
    mask = masks(SIZES)
    clean = jax.tree.map(lambda m, width: jnp.ones((*m.shape, width)), mask, PerType(agents=3, lanes=5))
    denoise = knowing(clean, CASES[case][1])
    led = with_energy_guidance(
        denoise, levels(case, 6), CASES[case][1], energy, mask,
        EnergyGuidance(rounds=1, below=0.0, agents=0.5, lanes=0.5),
    )  # fmt: skip
    x = drawn(case, led, KEYS, mask, steps=6)
    expected = 1 - 0.5 * (1 - WANTED)
    for kind in ("agents", "lanes"):
        np.testing.assert_allclose(getattr(x, kind)[getattr(mask, kind)], expected, atol=1e-4)


def test_steps_without_rounds_are_left_alone():
    denoise, schedule, mask = normal(0.5, 0.4, "velocity"), levels("ddpm", 16), masks(SIZES)
    energy_guidance = EnergyGuidance(below=0.35, agents=0.1, lanes=0.1)
    led = with_energy_guidance(denoise, schedule, "velocity", energy, mask, energy_guidance)
    rounds = rounds_of(energy_guidance.rounds, energy_guidance.below, schedule)
    assert rounds.nonzero()[0].tolist() == [0, 2]
    z = PerType(agents=jnp.ones((2, 7, 3)), lanes=jnp.ones((2, 9, 5)))
    for step in range(16):
        t = jnp.broadcast_to(jnp.asarray(schedule.time)[step], (2,))
        same = [np.array_equal(a, b) for a, b in zip(*(jax.tree.leaves(f(z, t)) for f in (led, denoise)), strict=True)]
        assert not any(same) if rounds[step] else all(same)


def test_momentum_goes_on_from_round_to_round():
    """Two rounds of a tenth of the way, momentum a half, by hand: from 1 towards 0."""
    mask = masks(SIZES)
    clean = jax.tree.map(lambda m, width: jnp.ones((*m.shape, width)), mask, PerType(agents=3, lanes=5))
    options = {"rounds": 2, "below": 0.0, "momentum": 0.5, "agents": 0.1, "lanes": 0.1}
    led = with_energy_guidance(
        knowing(clean, "velocity"), levels("ddpm", 6), "velocity",
        lambda *_: lambda x: 0.5 * sum(jnp.square(leaf).sum() for leaf in (x.agents, x.lanes)), mask,
        EnergyGuidance(**options),
    )  # fmt: skip
    x, way = 1.0, 0.0
    for _ in range(2):
        way = 0.5 * way - 0.1 * (x + 0.5 * way)
        x += way
    drawn_to = drawn("ddpm", led, KEYS, mask, steps=6)
    np.testing.assert_allclose(drawn_to.lanes[mask.lanes], x, atol=1e-4)


def test_the_energy_is_taken_around_the_estimate_of_every_step():
    """One that pulls to where the estimate was leaves it there, whatever the step."""
    mask = masks(SIZES)
    clean = jax.tree.map(lambda m, width: jnp.ones((*m.shape, width)), mask, PerType(agents=3, lanes=5))
    led = with_energy_guidance(
        knowing(clean, "velocity"), levels("ddpm", 6), "velocity",
        lambda start, step: lambda x: jnp.square(x.lanes - start.lanes).sum(), mask, EnergyGuidance(agents=0.5, lanes=0.2),
    )  # fmt: skip
    np.testing.assert_allclose(drawn("ddpm", led, KEYS, mask, steps=6).lanes[mask.lanes], 1.0, atol=1e-4)


def test_given_tokens_are_seen_as_they_are_and_not_moved():
    """The energy ties all agents of a scene together: given ones count with their clean values, and stay."""
    mask = masks([(3, 4)])
    generated = mask.replace(agents=mask.agents.at[:, 0].set(False))

    def tie(*_):
        return lambda x: 0.5 * jnp.square(x.agents[:, 1] - x.agents[:, 0]).sum()

    schedule = levels("ddpm", 16)
    led = with_energy_guidance(
        knowing(PerType(agents=jnp.zeros((1, 7, 3)), lanes=jnp.zeros((1, 9, 5))), "velocity"), schedule, "velocity", tie,
        generated, EnergyGuidance(rounds=60, below=0.35, momentum=0.0, agents=0.3, lanes=0.3),
    )  # fmt: skip
    z = PerType(agents=jnp.full((1, 7, 3), 2.0), lanes=jnp.zeros((1, 9, 5)))
    level = schedule[jnp.zeros(1, int)]
    output = led(z, jnp.asarray(level.time))
    x0 = level.signal[:, None, None] * z.agents - level.noise[:, None, None] * output.agents
    np.testing.assert_allclose(x0[:, 0], 2.0, atol=1e-5)
    np.testing.assert_allclose(x0[:, 1], 2.0, atol=1e-2)
    np.testing.assert_allclose(x0[:, 2], 0.0, atol=1e-5)


def test_every_scene_has_its_own_rounds():
    """Beside a scene of more rounds, and of more steps, one of fewer is what it is by itself."""
    denoise, schedule, energy_guidance = (
        normal(0.5, 0.4, "velocity"),
        levels("ddpm", 8),
        EnergyGuidance(agents=0.2, lanes=0.2),
    )
    few, many = np.zeros((2, 8), np.int32)
    few[[0, 2]], many[[0, 1, 2, 5]] = 2, 5

    def run(rows, rounds):
        mask = jax.tree.map(lambda x: x[rows], masks(SIZES))
        led = with_energy_guidance(denoise, schedule, "velocity", energy, mask, energy_guidance, np.stack(rounds))
        return drawn("ddpm", led, KEYS[rows], mask, steps=8)

    both = run(np.array([0, 1]), [few, many])
    for row, own in enumerate([few, many]):
        alone = run(np.array([row]), [own])
        chex.assert_trees_all_close(jax.tree.map(lambda x, row=row: x[row : row + 1], both), alone, atol=1e-6)


def test_a_scene_alone_equals_the_scene_in_a_batch():
    denoise = normal(0.5, 0.4, "velocity")

    def run(keys, mask):
        led = with_energy_guidance(
            denoise, levels("ddpm", 8), "velocity", energy, mask, EnergyGuidance(agents=0.2, lanes=0.2)
        )
        return drawn("ddpm", led, keys, mask, steps=8)

    both, one = run(KEYS, masks(SIZES)), run(KEYS[:1], masks(SIZES[:1]))
    chex.assert_trees_all_close(jax.tree.map(lambda x: x[:1], both), one, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"rounds": 0}, "rounds"),
        ({"below": 1.5}, "below"),
        ({"momentum": 1.0}, "momentum"),
        ({"agents": -1.0}, "agents"),
        ({"lanes": np.nan}, "lanes"),
    ],
)
def test_bad_options_are_named(options, named):
    with pytest.raises(ValueError, match=named):
        EnergyGuidance(**options)
