"""Errors, positions and coverage of made-up distributions; test_text_training runs the study on a trained model."""

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


def test_coverage_is_calibrated_for_the_true_distribution():
    rng = np.random.default_rng(0)
    rates = rng.uniform(3, 20, 4000)
    true = rng.poisson(rates)
    result = coverage(poisson(rates), true, 0)
    for level in (50, 80, 90):
        assert result[f"in_central_{level}_percent"] == pytest.approx(level / 100, abs=0.03)
    assert np.histogram(positions(poisson(rates), true, 1), 10, (0, 1))[0] == pytest.approx(400, abs=80)
    overconfident = np.repeat(poisson(rates)[:, ::3], 3, 1)[:, :60] ** 4
    assert coverage(overconfident / overconfident.sum(1, keepdims=True), true, 0)["in_central_90_percent"] < 0.8


def test_errors_match_hand_computed_values():
    shares = np.array([[0.0, 0.5, 0.5], [0.6, 0.0, 0.4]])
    result = errors(shares, np.array([1, 2]))
    assert result["mae_of_mean"] == pytest.approx((0.5 + 1.2) / 2) and result["mae_of_mode"] == 1.0


def test_picture_has_two_panels_per_element():
    shares = poisson(np.array([3.0, 5.0]))
    figure = draw({"lanes": shares, "agents": shares}, dict.fromkeys(("lanes", "agents"), np.array([2, 6])))
    assert len(figure.axes) == 4


def test_study_refuses_models_without_count_predictor(tmp_path):
    scjax.save(tiny_model(), tmp_path / "model")
    with pytest.raises(SystemExit, match="the model has no count predictor"):
        main([f"--model={tmp_path / 'model'}", f"--records={tmp_path}"])
