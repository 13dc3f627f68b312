"""Schedule, noising and posterior against schedule.npz and q_sample_*.npz."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from scjax.diffusion.process import estimate_x0, posterior_mean, posterior_std, q_sample
from scjax.diffusion.schedule import cosine_schedule, respace
from scjax.scene.per_type import PerType
from tests.factories import golden


def test_schedule_parity(parity_dir):
    expected = golden.load(parity_dir, "schedule.npz")
    schedule = cosine_schedule()
    np.testing.assert_array_equal(schedule.timesteps, np.arange(100))
    for name, reference in expected.items():
        if name == "log_one_minus_alphas_cumprod":  # used by nothing, so not stored
            value = np.log(np.float32(1) - schedule.alphas_cumprod)
            np.testing.assert_allclose(value[:-1], reference[:-1], rtol=2e-4)
            np.testing.assert_allclose(value[-1], reference[-1], rtol=2e-2)
            continue
        np.testing.assert_allclose(getattr(schedule, name), reference, rtol=2e-5, err_msg=name)
    named = {field.name for field in dataclasses.fields(schedule)}
    assert named - {"timesteps"} == expected.keys() - {"log_one_minus_alphas_cumprod"}


def test_q_sample_parity(parity_dir):
    inputs, outputs = (golden.load(parity_dir, f"q_sample_{part}.npz") for part in ("inputs", "outputs"))
    schedule = cosine_schedule()
    times = sorted({int(key.split("/")[0][1:]) for key in outputs})
    both = lambda x: PerType(agents=x, lanes=x)  # noqa: E731
    repeat = lambda x: jnp.repeat(jnp.asarray(x)[None], len(times), 0)  # noqa: E731
    clean, noise, steps = both(repeat(inputs["x0"])), both(repeat(inputs["noise"])), jnp.asarray(times)
    stored = both(jnp.stack([outputs[f"t{t}/x_t"] for t in times]))
    values = {
        "x_t": q_sample(schedule.levels[steps], clean, noise),
        "x0_from_x_t_and_noise": estimate_x0(schedule.levels[steps], stored, noise, "noise"),
        "posterior_mean": posterior_mean(schedule, clean, stored, steps),
    }
    for name, value in values.items():
        for i, t in enumerate(times):
            tolerance = {98: 2e-5, 99: 1e-3}.get(t, 1e-5) if name.startswith("x0") else 1e-5
            for leaf in jax.tree.leaves(value):
                assert golden.relative(leaf[i], outputs[f"t{t}/{name}"]) < tolerance, f"t{t}/{name}"


def test_posterior_std_is_zero_in_the_last_step():
    std = posterior_std(cosine_schedule(), jnp.array([0, 1, 99]))
    assert std[0] == 0 and (np.asarray(std[1:]) > 0).all()


def test_respace_keeps_the_noise_levels():
    schedule = cosine_schedule()
    fewer = respace(schedule, 20)
    np.testing.assert_array_equal(fewer.timesteps, np.arange(4, 100, 5))
    np.testing.assert_array_equal(fewer.alphas_cumprod, schedule.alphas_cumprod[fewer.timesteps])
    assert respace(schedule, 100) is schedule
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(fewer))


@pytest.mark.parametrize("steps", [1, 101])
def test_step_counts_out_of_range_are_refused(steps):
    with pytest.raises(ValueError, match=r"2\.\.100"):
        respace(cosine_schedule(), steps)
