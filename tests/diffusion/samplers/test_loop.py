"""The loop with simple denoisers: noise a scene, padding, clamping, temperature; ancestral sampling in closed form."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.samplers.loop import CLIP, clamp, sample, scene_noise
from scjax.diffusion.schedule import cosine_schedule, respaced
from scjax.scene.per_type import PerType
from tests.factories.sampler_oracles import CASES, MOST, WIDTHS, drawn
from tests.factories.sampler_oracles import masks as _masks

KEYS = jax.random.split(jax.random.key(0), 6)
SCHEDULE = cosine_schedule()


def _zeros(batch, agents, lanes):
    return PerType(agents=jnp.zeros((batch, agents, 3)), lanes=jnp.zeros((batch, lanes, 5)))


def _shrink(z, t):
    """Some estimate that is elementwise, so that scenes and tokens can't mix."""
    return jax.tree.map(lambda x: jnp.tanh(x) * (1 + t[:, None, None] / 100), z)


def test_noise_is_the_same_in_any_batch_and_padding():
    whole = _noise(KEYS, _zeros(6, 7, 9))
    for rows, (agents, lanes) in ((slice(0, 1), (7, 9)), (slice(2, 5), (4, 3)), (slice(1, 6), (1, 8))):
        part = _noise(KEYS[rows], _zeros(len(range(6)[rows]), agents, lanes))
        np.testing.assert_array_equal(part.agents, whole.agents[rows, :agents])
        np.testing.assert_array_equal(part.lanes, whole.lanes[rows, :lanes])


@jax.jit
def _noise(keys, like):
    return scene_noise(keys, 17, like, MOST)


def test_noise_differs_between_scenes_steps_and_kinds():
    like = PerType(agents=jnp.zeros((2, 7, 5)), lanes=jnp.zeros((2, 7, 5)))
    most = PerType(agents=7, lanes=7)
    one, two = (scene_noise(KEYS[:2], step, like, most) for step in (0, 1))
    init = [one.agents[0], one.agents[1], one.lanes[0], one.lanes[1], two.agents[0], two.lanes[1]]
    assert len({np.asarray(x).tobytes() for x in init}) == len(init)


def test_more_tokens_than_the_model_knows_are_refused():
    with pytest.raises(ValueError, match="8 tokens"):
        scene_noise(KEYS, 0, _zeros(6, 8, 9), MOST)


@pytest.mark.parametrize("case", CASES)
def test_samples_do_not_depend_on_batch_and_padding(case):
    sizes = [(3, 4), (7, 9), (1, 1)]
    whole = drawn(case, _shrink, KEYS[:3], _masks(sizes, 7, 9), steps=6)
    agents, lanes = sizes[0]
    alone = drawn(case, _shrink, KEYS[:1], _masks(sizes[:1], agents, lanes), steps=6)
    np.testing.assert_allclose(alone.agents[0], whole.agents[0, :agents], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(alone.lanes[0], whole.lanes[0, :lanes], rtol=1e-5, atol=1e-5)
    assert not np.any(whole.agents[0, agents:]) and not np.any(whole.lanes[0, lanes:])
    assert max(np.abs(leaf).max() for leaf in jax.tree.leaves(whole)) <= CLIP


@pytest.mark.parametrize("case", CASES)
def test_given_tokens_stay_bit_for_bit(case):
    masks = _masks([(3, 4), (7, 9)], 7, 9)
    rng = np.random.default_rng(0)
    known = jax.tree.map(lambda mask: mask & (rng.random(mask.shape) < 0.5), masks)
    known = known.replace(lanes=known.lanes.at[1].set(masks.lanes[1]))  # lane-conditioned
    init = jax.tree.map(lambda flag, width: 7 * jnp.asarray(rng.normal(size=(*flag.shape, width))), known, WIDTHS)
    values = jax.tree.map(lambda flag, draw: jnp.where(flag[..., None], draw, jnp.nan), known, init)
    result = drawn(case, _shrink, KEYS[:2], masks, steps=6, known=known, values=values)
    for kind in ("agents", "lanes"):
        flags = np.asarray(getattr(known, kind))
        np.testing.assert_array_equal(
            np.asarray(getattr(result, kind))[flags], np.asarray(getattr(values, kind))[flags]
        )
        assert np.isfinite(getattr(result, kind)).all()
    with pytest.raises(ValueError, match="values"):
        clamp(values, known, None)


@pytest.mark.parametrize("steps", [100, 25])
def test_the_exact_estimate_of_a_gaussian_follows_its_recursion(steps):
    """x_0 ~ N(m, s^2): the optimal estimate is linear, so mean and variance of every step are known in closed form.

    (The end is close to m and s but narrower: the posterior variance is the lower bound of Ho et al. 2020.)
    """
    mean, std, scenes = 0.7, 0.4, 400
    schedule = respaced(SCHEDULE, steps)

    def slope(level):
        """Optimal estimate = slope (x - sqrt(level) m)."""
        return np.sqrt(1 - level) / (level * std**2 + 1 - level)

    at, variance = 0.0, 1.0
    for i in range(steps - 1, -1, -1):
        level = np.float64(schedule.alphas_cumprod[i])
        a, b = (np.float64(getattr(schedule, f"sqrt_recip{m}_alphas_cumprod")[i]) for m in ("", "m1"))
        c, d = (np.float64(getattr(schedule, f"posterior_mean_coef{n}")[i]) for n in (1, 2))
        gain = c * (a - b * slope(level)) + d
        at = gain * at + c * b * slope(level) * np.sqrt(level) * mean
        variance = gain**2 * variance + (schedule.posterior_variance[i] if i else 0)
    assert abs(at - mean) < 0.01 and abs(np.sqrt(variance) - std) < 0.1

    def denoise(z, t):
        level = jnp.asarray(SCHEDULE.alphas_cumprod)[t][:, None, None]
        optimal = jnp.sqrt(1 - level) / (level * std**2 + 1 - level)
        return jax.tree.map(lambda x: optimal * (x - jnp.sqrt(level) * mean), z)

    keys, masks = jax.random.split(jax.random.key(1), scenes), _masks([(7, 9)] * scenes, 7, 9)
    even = PerType(agents=1.0, lanes=1.0)
    result = jax.jit(
        lambda: sample(denoise, schedule, keys, masks, widths=WIDTHS, most=MOST, temperature=even, clip=None)
    )()
    for leaf in jax.tree.leaves(result):
        np.testing.assert_allclose(leaf.mean(), at, atol=0.015)
        np.testing.assert_allclose(leaf.std(), np.sqrt(variance), rtol=0.02)


def test_a_seed_starts_alike_in_any_number_of_steps():
    """Where the velocity is zero, the end is the start."""
    masks = _masks([(7, 9)] * 6, 7, 9)
    ends = [drawn("euler", lambda z, t: jax.tree.map(jnp.zeros_like, z), KEYS, masks, steps) for steps in (3, 7)]
    jax.tree.map(np.testing.assert_array_equal, *ends)
    assert 0.9 < ends[0].agents.std() < 1.1


def test_temperature_scales_the_noise_of_a_kind():
    """With an estimate of zero noise nothing but the drawn noise moves the state."""
    masks = _masks([(7, 9)] * 6, 7, 9)
    quiet = jax.jit(
        lambda: sample(
            lambda z, t: jax.tree.map(jnp.zeros_like, z),
            respaced(SCHEDULE, 2),
            KEYS,
            masks,
            widths=WIDTHS,
            most=MOST,
            temperature=PerType(agents=1.0, lanes=0.0),
        )
    )()
    assert np.any(quiet.agents) and not np.any(quiet.lanes)
