"""Guidance: both branches in one batch, in an interval of times, with the deviation led back."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.guidance import Guidance, guided, join, rescaled
from scjax.scene.per_type import PerType
from tests.factories.sampler_oracles import CASES, drawn, masks, normal


def ones(batch, agents, lanes):
    return PerType(agents=jnp.ones((batch, agents, 3)), lanes=jnp.ones((batch, lanes, 5)))


def test_guidance_joins_both_branches_in_one_batch():
    label = join(jnp.ones(2), jnp.full(2, 3.0))
    calls = []

    def both(z, t):
        calls.append((z.lanes.shape, t.shape))
        return jax.tree.map(lambda x: x * label[:, None, None], z)

    z, t = ones(2, 1, 2), jnp.zeros(2, jnp.int32)
    for weight, expected in ((1.0, 1.0), (0.0, 3.0), (4.0, -5.0)):
        np.testing.assert_allclose(guided(both, weight)(z, t).lanes, expected)
    np.testing.assert_allclose(guided(both, jnp.array([1.0, 4.0]))(z, t).agents[:, 0, 0], [1.0, -5.0])
    assert calls == [((4, 2, 5), (4,))] * 4


def branches(prediction):
    """(both, one): two normal distributions, the conditional one of mean 0.5."""
    conditional, other = normal(0.5, 0.4, prediction), normal(-0.2, 0.9, prediction)

    def both(z, t):
        half = len(t) // 2
        first, second = (jax.tree.map(lambda x, s=s: x[s], z) for s in (slice(half), slice(half, None)))
        return join(conditional(first, t[:half]), other(second, t[half:]))

    return both, conditional


KEYS = jax.random.split(jax.random.key(3), 3)
SIZES = [(3, 4), (7, 9), (1, 1)]


@pytest.mark.parametrize("case", ["ddim, eta 0.7", "heun"])
def test_samplers_agree_with_themselves_under_guidance_that_is_none(case):
    """Weight 1 is plain sampling; the interval of all times is constant guidance; an empty one is none."""
    both, one = branches(CASES[case][1])

    def run(denoise):
        return drawn(case, denoise, KEYS, masks(SIZES), steps=4)

    plain, constant = run(one), run(guided(both, 3.0))
    same = {
        "weight 1": (plain, run(guided(both, 1.0))),
        "all times": (constant, run(guided(both, 3.0, interval=(0, 99), denoise_one=one))),
        "no time": (plain, run(guided(both, 3.0, interval=(30.2, 30.8), denoise_one=one))),
    }
    for name, pair in same.items():
        jax.tree.map(lambda x, y, name=name: np.testing.assert_allclose(x, y, atol=2e-5, err_msg=name), *pair)
    assert np.abs(plain.lanes - constant.lanes).max() > 0.05


def test_outside_of_the_interval_the_second_branch_is_not_run():
    ran = []

    def both(z, t):
        jax.debug.callback(lambda: ran.append("both"))
        return jax.tree.map(lambda x: 2 * x, z)

    def one(z, t):
        jax.debug.callback(lambda: ran.append("one"))
        return z

    denoise = jax.jit(guided(both, 4.0, interval=(20, 60), denoise_one=one))
    for t, expected in ((61, "one"), (60, "both"), (20, "both"), (19, "one")):
        ran.clear()
        jax.block_until_ready(denoise(ones(2, 1, 2), jnp.full(2, t)))
        jax.effects_barrier()
        assert ran == [expected], t


def test_scenes_at_different_times_have_their_own_weights():
    def both(z, t):
        return join(jax.tree.map(lambda x: 1 + 0 * x[:2], z), jax.tree.map(lambda x: 0 * x[:2], z))

    found = guided(both, 4.0, interval=(20, 60))(ones(2, 1, 2), jnp.array([10, 40]))
    np.testing.assert_allclose(found.lanes[:, 0, 0], [1.0, 4.0])


def test_rescaling_leads_the_deviation_back():
    rng = np.random.default_rng(0)
    led, conditional = (
        PerType(agents=jnp.asarray(scale * rng.normal(size=(2, 4, 3))), lanes=jnp.asarray(rng.normal(size=(2, 6, 5))))
        for scale in (7.0, 1.0)
    )
    generated = PerType(
        agents=jnp.arange(4)[None] < jnp.array([[3], [4]]), lanes=jnp.arange(6)[None] < jnp.array([[6], [2]])
    )

    def deviation(pair, kind, scene):
        return np.std(np.asarray(getattr(pair, kind))[scene][np.asarray(getattr(generated, kind))[scene]])

    whole, half, none = (rescaled(led, conditional, share, generated) for share in (1.0, 0.5, 0.0))
    for kind in ("agents", "lanes"):
        for scene in (0, 1):
            wanted, found = (deviation(pair, kind, scene) for pair in (conditional, led))
            np.testing.assert_allclose(deviation(whole, kind, scene), wanted, rtol=1e-5)
            np.testing.assert_allclose(deviation(half, kind, scene), (wanted + found) / 2, rtol=1e-5)
    jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-6), none, led)
    spoilt = led.replace(lanes=led.lanes.at[1, 2:].set(1e6))
    np.testing.assert_allclose(
        rescaled(spoilt, conditional, 1.0, generated).lanes[1, :2], whole.lanes[1, :2], rtol=1e-5
    )
    nothing = jax.tree.map(jnp.zeros_like, led)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(rescaled(nothing, conditional, 1.0, generated)))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"weight": float("nan")}, "finite"),
        ({"interval": (60.0, 20.0)}, "lowest time, highest time"),
        ({"rescale": 1.5}, "0 .*1"),
    ],
)
def test_impossible_guidance_is_refused(options, says):
    with pytest.raises(ValueError, match=says):
        Guidance(**options)
