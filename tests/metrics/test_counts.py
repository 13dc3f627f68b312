"""Errors of predicted numbers, by hand."""

import math

import numpy as np
import pytest

from scjax.metrics.counts import calibration, count_errors


def test_count_errors_match_hand_computed_values():
    errors = count_errors(np.array([10, 20, 30, 40]), np.array([10.0, 21.0, 30.4, 36.0]))
    assert errors["mae"] == pytest.approx((0 + 1 + 0.4 + 4) / 4) and errors["bias"] == pytest.approx(-2.6 / 4)
    assert (errors["exact"], errors["within_1"], errors["within_10_percent"]) == (0.5, 0.75, 1.0)
    assert errors["spearman"] == pytest.approx(1)


def test_count_errors_are_nan_where_undefined():
    assert all(map(math.isnan, count_errors(np.zeros(0, int), np.zeros(0)).values()))
    assert math.isnan(count_errors(np.array([3, 3]), np.array([1.0, 2.0]))["spearman"])
    with pytest.raises(ValueError, match="1 predicted numbers"):
        count_errors(np.array([3, 3]), np.array([1.0, np.nan]))


def test_calibration_groups_have_equal_means():
    rng = np.random.default_rng(0)
    mean = rng.uniform(2, 40, 20_000)
    groups = calibration(rng.poisson(mean), mean)
    assert sum(group.scenes for group in groups) == 20_000 and len(groups) == 10
    assert all(abs(group.true - group.predicted) < 0.5 for group in groups)
    skewed = calibration(rng.poisson(mean), mean + 5)
    assert all(group.predicted - group.true > 4 for group in skewed)
