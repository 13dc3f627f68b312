"""Errors, positions and coverage of made-up distributions; the script on a trained model is in test_text_training."""

from __future__ import annotations

import numpy as np
import pytest

import scjax
from experiments.studies.count_calibration import coverage, draw, errors, main, positions
from tests.factories.worlds import tiny_model


def poisson(rate, size=60):
    numbers = np.arange(size)
    log = numbers * np.log(rate)[:, None] - rate[:, None] - np.cumsum(np.log(np.maximum(numbers, 1)))
    return np.exp(log) / np.exp(log).sum(1, keepdims=True)


def test_draws_from_the_told_distribution_are_calibrated_and_others_are_not():
    rng = np.random.default_rng(0)
    rates = rng.uniform(3, 20, 4000)
    true = rng.poisson(rates)
    found = coverage(poisson(rates), true, 0)
    for level in (50, 80, 90):
        assert found[f"in_central_{level}_percent"] == pytest.approx(level / 100, abs=0.03)
    assert np.histogram(positions(poisson(rates), true, 1), 10, (0, 1))[0] == pytest.approx(400, abs=80)
    sure = np.repeat(poisson(rates)[:, ::3], 3, 1)[:, :60] ** 4
    assert coverage(sure / sure.sum(1, keepdims=True), true, 0)["in_central_90_percent"] < 0.8


def test_errors_by_hand():
    shares = np.array([[0.0, 0.5, 0.5], [0.6, 0.0, 0.4]])
    found = errors(shares, np.array([1, 2]))
    assert found["mae_of_mean"] == pytest.approx((0.5 + 1.2) / 2) and found["mae_of_mode"] == 1.0


def test_the_picture_has_two_panels_a_number(tmp_path):
    shares = poisson(np.array([3.0, 5.0]))
    figure = draw(
        {"lanes": shares, "agents": shares}, dict.fromkeys(("lanes", "agents"), np.array([2, 6])), tmp_path / "c.png"
    )
    assert len(figure.axes) == 4 and (tmp_path / "c.png").stat().st_size > 5_000


def test_a_model_without_a_counter_is_refused(tmp_path):
    scjax.save(tiny_model(), tmp_path / "model")
    with pytest.raises(SystemExit, match="the model has no counter"):
        main([f"--model={tmp_path / 'model'}", f"--records={tmp_path}"])
