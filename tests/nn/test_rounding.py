"""Arrays as 8-bit integers."""

from __future__ import annotations

import numpy as np

from scjax.nn.rounding import restore_arrays, round_arrays


def test_large_matrices_are_restored_within_half_a_step():
    rng = np.random.default_rng(0)
    arrays = {"kernel": rng.normal(size=(64, 32)).astype(np.float32), "bias": rng.normal(size=32).astype(np.float32)}
    arrays["kernel"][:, 3] = 0
    rounded = round_arrays(arrays)
    assert rounded["kernel"].dtype == np.int8
    restored = restore_arrays(rounded)
    assert restored.keys() == arrays.keys() and np.array_equal(restored["bias"], arrays["bias"])
    step = np.abs(arrays["kernel"]).max(0) / 127
    assert (np.abs(restored["kernel"] - arrays["kernel"]) <= 0.51 * step + 1e-6).all()


def test_arrays_that_were_never_rounded_stay():
    arrays = {"kernel": np.ones((64, 32), np.float32)}
    assert restore_arrays(arrays)["kernel"] is arrays["kernel"]
