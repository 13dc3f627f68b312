"""Classifier-free guidance: both branches in one batch, an interval of times, and rescaling."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.guidance import Guidance, concat_branches, rescale_guidance, with_guidance
from scjax.scene.per_type import PerType
from tests.factories.sampler_oracles import SAMPLER_CASES, gaussian_denoiser, sample_case, token_masks

KEYS = jax.random.split(jax.random.key(3), 3)
SIZES = [(3, 4), (7, 9), (1, 1)]


def ones(batch, agents, lanes):
    return PerType(agents=jnp.ones((batch, agents, 3)), lanes=jnp.ones((batch, lanes, 5)))


def gaussian_branches(prediction):
    """(both branches, conditional branch) of two Gaussians; the conditional one has mean 0.5."""
    conditional, unconditional = gaussian_denoiser(0.5, 0.4, prediction), gaussian_denoiser(-0.2, 0.9, prediction)

    def denoise_both(z, t):
        half = len(t) // 2
        first, second = (jax.tree.map(lambda x, s=s: x[s], z) for s in (slice(half), slice(half, None)))
        return concat_branches(conditional(first, t[:half]), unconditional(second, t[half:]))

    return denoise_both, conditional


def test_both_branches_run_in_one_batch():
    factor = concat_branches(jnp.ones(2), jnp.full(2, 3.0))
    calls = []

    def denoise_both(z, t):
        calls.append((z.lanes.shape, t.shape))
        return jax.tree.map(lambda x: x * factor[:, None, None], z)

    z, t = ones(2, 1, 2), jnp.zeros(2, jnp.int32)
    for scale, expected in ((1.0, 1.0), (0.0, 3.0), (4.0, -5.0)):
        np.testing.assert_allclose(with_guidance(denoise_both, scale)(z, t).lanes, expected)
    per_scene = with_guidance(denoise_both, jnp.array([1.0, 4.0]))(z, t)
    np.testing.assert_allclose(per_scene.agents[:, 0, 0], [1.0, -5.0])
    assert calls == [((4, 2, 5), (4,))] * 4


@pytest.mark.parametrize(("w", "v", "expected"), [(4.0, 4.0, -5.0), (0.0, 0.0, 3.0), (2.0, 0.0, 7.0), (0.0, 2.0, -5.0)])
def test_request_and_picture_have_scales_of_their_own(w, v, expected):
    """u + w (r - u) + v (c - r) with c = 1, u = 3, r = 5; equal scales are those of both together."""
    factor = jnp.repeat(jnp.array([1.0, 3.0, 5.0]), 2)

    def denoise_three(z, t):
        assert z.lanes.shape == (6, 2, 5) and t.shape == (6,)
        return jax.tree.map(lambda x: x * factor[:, None, None], z)

    z, t = ones(2, 1, 2), jnp.array([10, 40])
    np.testing.assert_allclose(with_guidance(denoise_three, w, image_scale=v)(z, t).lanes, expected)
    outside = with_guidance(denoise_three, w, image_scale=v, interval=(20, 60))(z, t).agents
    np.testing.assert_allclose(outside[:, 0, 0], [1.0, expected])


@pytest.mark.parametrize("case", ["ddim, eta 0.7", "heun"])
def test_scale_one_and_trivial_intervals_change_nothing(case):
    """Scale 1 is plain sampling; the interval of all times is constant guidance; an empty one is no guidance."""
    denoise_both, conditional = gaussian_branches(SAMPLER_CASES[case][1])

    def run(denoise):
        return sample_case(case, denoise, KEYS, token_masks(SIZES), steps=4)

    def run_interval(interval):
        return run(with_guidance(denoise_both, 3.0, interval=interval, denoise_conditional=conditional))

    plain, constant = run(conditional), run(with_guidance(denoise_both, 3.0))
    pairs = {
        "scale 1": (plain, run(with_guidance(denoise_both, 1.0))),
        "all times": (constant, run_interval((0, 99))),
        "no time": (plain, run_interval((30.2, 30.8))),
    }
    for name, pair in pairs.items():
        jax.tree.map(lambda x, y, name=name: np.testing.assert_allclose(x, y, atol=2e-5, err_msg=name), *pair)
    assert np.abs(plain.lanes - constant.lanes).max() > 0.05


def test_outside_the_interval_only_the_conditional_branch_runs():
    branches = []

    def denoise_both(z, t):
        jax.debug.callback(lambda: branches.append("both"))
        return jax.tree.map(lambda x: 2 * x, z)

    def denoise_conditional(z, t):
        jax.debug.callback(lambda: branches.append("conditional"))
        return z

    denoise = jax.jit(with_guidance(denoise_both, 4.0, interval=(20, 60), denoise_conditional=denoise_conditional))
    for t, expected in ((61, "conditional"), (60, "both"), (20, "both"), (19, "conditional")):
        branches.clear()
        jax.block_until_ready(denoise(ones(2, 1, 2), jnp.full(2, t)))
        jax.effects_barrier()
        assert branches == [expected], t


def test_scenes_at_different_times_have_their_own_scale():
    def denoise_both(z, t):
        return concat_branches(jax.tree.map(lambda x: 1 + 0 * x[:2], z), jax.tree.map(lambda x: 0 * x[:2], z))

    guided = with_guidance(denoise_both, 4.0, interval=(20, 60))(ones(2, 1, 2), jnp.array([10, 40]))
    np.testing.assert_allclose(guided.lanes[:, 0, 0], [1.0, 4.0])


@pytest.fixture(scope="module")
def estimates():
    """(guided, conditional, generated): the guided agents deviate seven times as much."""
    rng = np.random.default_rng(0)
    guided, conditional = (
        PerType(agents=jnp.asarray(scale * rng.normal(size=(2, 4, 3))), lanes=jnp.asarray(rng.normal(size=(2, 6, 5))))
        for scale in (7.0, 1.0)
    )
    generated = PerType(
        agents=jnp.arange(4)[None] < jnp.array([[3], [4]]), lanes=jnp.arange(6)[None] < jnp.array([[6], [2]])
    )
    return guided, conditional, generated


def test_rescaling_restores_the_standard_deviation(estimates):
    guided, conditional, generated = estimates

    def std(latents, name, scene):
        return np.std(np.asarray(getattr(latents, name))[scene][np.asarray(getattr(generated, name))[scene]])

    full, half, none = (rescale_guidance(guided, conditional, phi, generated) for phi in (1.0, 0.5, 0.0))
    for name in ("agents", "lanes"):
        for scene in (0, 1):
            conditional_std, guided_std = (std(latents, name, scene) for latents in (conditional, guided))
            np.testing.assert_allclose(std(full, name, scene), conditional_std, rtol=1e-5)
            np.testing.assert_allclose(std(half, name, scene), (conditional_std + guided_std) / 2, rtol=1e-5)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-6), none, guided)


def test_rescaling_ignores_tokens_that_are_not_generated(estimates):
    guided, conditional, generated = estimates
    full = rescale_guidance(guided, conditional, 1.0, generated)
    garbage = guided.replace(lanes=guided.lanes.at[1, 2:].set(1e6))
    rescaled = rescale_guidance(garbage, conditional, 1.0, generated)
    np.testing.assert_allclose(rescaled.lanes[1, :2], full.lanes[1, :2], rtol=1e-5)


def test_rescaling_a_zero_estimate_is_finite(estimates):
    guided, conditional, generated = estimates
    rescaled = rescale_guidance(jax.tree.map(jnp.zeros_like, guided), conditional, 1.0, generated)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(rescaled))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale": float("nan")}, "finite"),
        ({"interval": (60.0, 20.0)}, "lowest time, highest time"),
        ({"rescale": 1.5}, r"in 0\.\.1, not 1\.5"),
    ],
)
def test_invalid_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Guidance(**options)
