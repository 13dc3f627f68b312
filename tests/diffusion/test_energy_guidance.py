"""Energy guidance: latents descend the energy of the scene that they decode to; known tokens do not move."""

from __future__ import annotations

import dataclasses
import json

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.defaults import DEFAULT_ENERGIES
from scjax.diffusion.energies import connection_energy, weighted_energy
from scjax.diffusion.energy_guidance import (
    Descent,
    EnergyGuidance,
    descend,
    gradient_steps_per_level,
    shift_points,
)
from scjax.diffusion.samplers import make_schedule
from scjax.models.denoiser.position_head import ALONG, POINTS, UNIT
from scjax.scene import Link, Scene
from scjax.scene.per_type import PerType
from tests.factories.examples import example_scene
from tests.factories.sampler_oracles import SAMPLER_CASES

WIDTHS = PerType(agents=4, lanes=10)
"""In these tests latents are points: of an agent its center and the point ahead, of a lane its five points."""


def case_levels(case, steps):
    sampler, prediction = SAMPLER_CASES[case]
    return make_schedule(sampler, prediction, steps).levels


def points_fn(latents):
    return jax.tree.map(lambda z, points: z.reshape(*z.shape[:2], points, 2), latents, POINTS)


def batch(seed=0, agents=3, lanes=4):
    scene = example_scene(seed, agents=agents, lanes=lanes)
    return jax.tree.map(lambda x: jnp.asarray(x)[None], scene)


def decode(scene, latents):
    """``scene`` with the points of ``latents`` [m]: the decoder for which the position heads are exact."""
    start = PerType(agents=jnp.zeros((1, scene.agents.shape[1], 4)), lanes=jnp.zeros((1, scene.lanes.shape[1], 10)))
    shift = jax.tree.map(lambda z, z0: UNIT * (z - z0), *map(points_fn, (latents, start)))
    return shift_points(scene, shift)


def at_rest(scene):
    zeros = PerType(agents=jnp.zeros((1, scene.agents.shape[1], 4)), lanes=jnp.zeros((1, scene.lanes.shape[1], 10)))
    return Descent(latents=zeros, velocity=zeros, lookahead=zeros)


def generated(scene):
    return PerType(agents=scene.agent_mask, lanes=scene.lane_mask)


def linked(scene):
    """Lane 1 follows lane 0."""
    links = np.zeros(scene.links.shape, np.int32)
    links[0, 0, 1], links[0, 1, 0] = Link.PREDECESSOR, Link.SUCCESSOR
    return scene.replace(links=jnp.asarray(links))


def run(scene, options, steps, mask=None):
    """Latents after gradient steps, each from the scene that the lookahead decodes to."""
    descent = at_rest(scene)
    step = jax.jit(lambda d, s: descend(d, s, points_fn, generated(scene) if mask is None else mask, options))
    for _ in range(steps):
        descent = step(descent, decode(scene, descent.lookahead))
    return descent.latents


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


CONNECTIONS = (("connections", 1.0),)


def test_descent_closes_an_open_connection():
    scene = linked(batch())
    options = EnergyGuidance(momentum=0.0, lane_step_size=0.4 / UNIT**2, agent_step_size=0.0, energies=CONNECTIONS)
    latents = run(scene, options, 40)
    before, after = (float(connection_energy(x)[0]) for x in (scene, decode(scene, latents)))
    assert before > 1 and after < 1e-3 * before
    ends = np.asarray(points_fn(latents).lanes)
    moved = np.abs(ends[0]).sum(-1) > 0
    assert moved[0].nonzero()[0].tolist() == [len(ALONG) - 1] and moved[1].nonzero()[0].tolist() == [0]
    assert not moved[2:].any() and not np.any(latents.agents)


def test_one_gradient_step_is_the_gradient_in_meters():
    """A lane's end moves by the step size times the gap, in meters."""
    scene = linked(batch())
    gap = np.asarray(scene.lanes[0, 1, 0, :2] - scene.lanes[0, 0, -1, :2])
    options = EnergyGuidance(lane_step_size=0.1 / UNIT**2, energies=CONNECTIONS)
    moved = UNIT * np.asarray(points_fn(run(scene, options, 1)).lanes)[0, 0, -1]
    weight = 1 / np.sqrt(1 + (gap**2).sum() / 25)  # pseudo-Huber
    np.testing.assert_allclose(moved, 0.1 * weight * gap, rtol=1e-4)


def test_momentum_carries_over_between_gradient_steps():
    """Two Nesterov steps equal those by hand, from gradients of the whole energy through the decoder."""
    scene = linked(batch())
    options = EnergyGuidance(
        momentum=0.5, agent_step_size=0.3 / UNIT**2, lane_step_size=0.2 / UNIT**2, energies=DEFAULT_ENERGIES
    )
    gradient = jax.jit(jax.grad(lambda z: weighted_energy(decode(scene, z), options.energies).sum()))
    x = velocity = at_rest(scene).latents
    sizes = PerType(agents=options.agent_step_size, lanes=options.lane_step_size)
    for _ in range(2):
        slope = gradient(jax.tree.map(lambda x, v: x + 0.5 * v, x, velocity))
        velocity = jax.tree.map(lambda v, g, size: 0.5 * v - size * g, velocity, slope, sizes)
        x = jax.tree.map(jnp.add, x, velocity)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-7), run(scene, options, 2), x)
    assert np.abs(x.lanes).max() > 1e-3


def test_known_tokens_do_not_move():
    """The connection closes from its other side alone."""
    scene = linked(batch())
    mask = generated(scene)
    mask = mask.replace(lanes=mask.lanes.at[0, 0].set(False))
    options = EnergyGuidance(momentum=0.0, lane_step_size=0.4 / UNIT**2, energies=CONNECTIONS)
    latents = run(scene, options, 60, mask)
    assert not np.any(latents.lanes[0, 0]) and np.any(latents.lanes[0, 1])
    assert connection_energy(decode(scene, latents))[0] < 1e-3 * connection_energy(scene)[0]


def test_a_scene_does_not_depend_on_its_batch():
    first, second = linked(batch(0)), linked(batch(1))
    both: Scene = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), first, second)
    options = EnergyGuidance(lane_step_size=0.1 / UNIT**2, agent_step_size=0.1 / UNIT**2)
    start = jax.tree.map(lambda x: jnp.concatenate([x, x]), at_rest(first))
    step = jax.jit(lambda descent, scene: descend(descent, scene, points_fn, generated(scene), options))
    together, alone = step(start, both), step(at_rest(first), first)
    chex.assert_trees_all_close(jax.tree.map(lambda x: x[:1], together), alone, atol=1e-6)


def test_points_between_the_heads_move_with_them():
    scene = batch()
    shift = points_fn(at_rest(scene).latents)
    shift = shift.replace(lanes=shift.lanes.at[0, 0, -1].set(jnp.array([2.0, 1.0])))
    moved = np.asarray(shift_points(scene, shift).lanes - scene.lanes)[0]
    np.testing.assert_allclose(moved[0, -1], [2, 1, 0], atol=1e-5)
    assert not moved[1:].any() and not moved[0, : ALONG[-2] + 1].any()
    assert (np.diff(moved[0, ALONG[-2] :, 0]) > 0).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gradient_steps": 0}, "gradient_steps"),
        ({"max_sigma": 1.5}, "max_sigma"),
        ({"momentum": 1.0}, "momentum"),
        ({"agent_step_size": -1.0}, "agent_step_size"),
        ({"lane_step_size": np.nan}, "lane_step_size"),
        ({"energies": ()}, "energies is empty"),
        ({"energies": (("magic", 1.0),)}, "must be one of connections, overlap, off_lane, collision, not 'magic'"),
        (
            {"energies": (("overlap", -1.0),)},
            "the weight of .overlap. in EnergyGuidance.energies must be",
        ),
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
