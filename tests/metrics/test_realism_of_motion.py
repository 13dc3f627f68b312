"""Likelihood of recorded motion under simulated motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.metrics.motion_likelihood import (
    BUCKETS,
    FEATURES,
    INDICATION,
    WEIGHTS_2024,
    WEIGHTS_2025,
    HistogramSpec,
    bin_numbers,
    log_likelihoods,
)
from scjax.metrics.realism_of_motion import realism_of_motion, realism_of_motion_table
from scjax.scene import Signal
from tests.factories.motion_logs import moved_log, noisy_log, select_objects, straight_log, traffic_log, with_ghosts

LOG = traffic_log(0)
ROLLOUTS = [noisy_log(LOG, k, 0.1) for k in range(4)]


def table(logged, simulated, **options):
    return realism_of_motion_table(realism_of_motion(logged, simulated, **options))


def assert_equal(first, second, tolerance=1e-9):
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert second[name] == pytest.approx(value, abs=tolerance, nan_ok=True), name


def test_likelihoods_are_smoothed_shares_of_simulated_values():
    spec = HistogramSpec(0.0, 4.0, 4, 0.5)
    simulated = np.array([[[0.1, 0.2, 3.9]], [[1.5, 9.0, 2.0]]])
    valid = np.array([[[True, True, True]], [[True, True, False]]])
    actual = log_likelihoods(np.array([[0.9, 1.0, 2.5, -3.0, 4.0]]), simulated, valid, spec)
    counts = np.array([2, 1, 0, 2]) + 0.5
    np.testing.assert_allclose(np.exp(actual[0]), counts[[0, 1, 2, 0, 3]] / counts.sum())
    empty = log_likelihoods(np.zeros((1, 1)), simulated, np.zeros_like(valid), spec)
    np.testing.assert_allclose(np.exp(empty), 1 / 4)


def test_indications_have_two_bins():
    assert bin_numbers(np.array([0.0, 1.0]), INDICATION).tolist() == [0, 1]


@pytest.mark.parametrize("weights", [WEIGHTS_2024, WEIGHTS_2025])
def test_weights_of_all_features_add_up_to_one(weights):
    assert set(weights) == set(FEATURES) == {name for names in BUCKETS.values() for name in names}
    assert sum(weights.values()) == pytest.approx(1.0)


def test_log_itself_is_more_likely_than_noisy_logs():
    scores = []
    for scale in (0.0, 0.05, 0.3, 1.0):
        scores.append(table(LOG, [noisy_log(LOG, k, scale) for k in range(4)]))
    for name in ("metametric", "kinematic_likelihood", "interactive_likelihood", "linear_acceleration_likelihood"):
        values = [score[name] for score in scores]
        assert values == sorted(values, reverse=True) and values[0] > values[-1] + 0.02, name
    ades = [score["ade"] for score in scores]
    assert ades[0] == 0 and ades == sorted(ades)


def test_indications_of_the_log_itself_are_certain():
    row = table(LOG, [LOG] * 4)
    for name in ("collision_indication", "offroad_indication", "traffic_light_violation"):
        assert row[f"{name}_likelihood"] == pytest.approx(4.001 / 4.002)
    for rate in ("collision", "offroad", "red_light"):
        assert row[f"{rate}_simulated"] == row[f"{rate}_logged"]
    assert row["presence"] == 1 and row["min_ade"] == 0


def test_metametric_is_the_weighted_mean_of_the_likelihoods():
    row = table(LOG, ROLLOUTS)
    expected = sum(weight * row[f"{name}_likelihood"] for name, weight in WEIGHTS_2025.items())
    assert row["metametric"] == pytest.approx(expected)
    assert 0 < row["metametric"] < 1
    assert table(LOG, ROLLOUTS, weights={"linear_speed": 2.0})["metametric"] == row["linear_speed_likelihood"]


def test_order_of_objects_and_rollouts_does_not_matter():
    order = np.random.default_rng(1).permutation(LOG.num_objects).tolist()
    shuffled = [select_objects(log, order if k % 2 else order[::-1]) for k, log in enumerate(ROLLOUTS[::-1])]
    assert_equal(table(LOG, ROLLOUTS), table(LOG, shuffled))
    assert_equal(table(LOG, ROLLOUTS), table(select_objects(LOG, order), ROLLOUTS))


def test_objects_that_are_never_there_do_not_matter():
    assert_equal(table(LOG, ROLLOUTS), table(with_ghosts(LOG, 3), [with_ghosts(log, 2) for log in ROLLOUTS]))


def test_rigid_motion_of_everything_does_not_matter():
    move = (2.1, (3000.0, -500.0))
    moved = table(moved_log(LOG, *move), [moved_log(log, *move) for log in ROLLOUTS])
    assert_equal(table(LOG, ROLLOUTS), moved, 1e-6)


def test_objects_that_a_rollout_adds_are_obstacles_only():
    log = straight_log((0, 0, 0, 5), (0, 50, 0, 5))
    other = straight_log((0, 0, 0, 5), (0, 50, 0, 5), (10, 0, 0, 0))
    row = table(log, [other])
    assert (row["collision_simulated"], row["collision_logged"]) == (0.5, 0)
    assert row["presence"] == 1 and row["linear_speed_likelihood"] == table(log, [log])["linear_speed_likelihood"]


def test_objects_that_a_rollout_removes_give_no_values():
    log = straight_log((0, 0, 0, 6), (0, 50, 0, 6))
    valid = log.valid.copy()
    valid[1, 21:] = False
    early = dataclasses.replace(log, valid=valid)
    row = table(log, [early])
    assert row["presence"] == pytest.approx(0.75)
    full = table(log, [log])
    assert row["linear_speed_likelihood"] < full["linear_speed_likelihood"]
    gone = table(log, [select_objects(log, [0])])
    assert gone["presence"] == pytest.approx(0.5)
    steps = 39  # with a known speed, of 40 that are measured
    expected = (np.log((steps + 0.1) / (steps + 1)) + np.log(0.1)) / 2  # all in one bin of ten, and uniform
    assert gone["linear_speed_likelihood"] == pytest.approx(np.exp(expected))
    assert gone["collision_simulated"] == 0


def test_steps_that_the_log_lacks_are_not_measured():
    valid = LOG.valid.copy()
    valid[:, 30:] = False
    cut = dataclasses.replace(LOG, valid=valid)
    broken = [noisy_log(LOG, k, 0.0) for k in range(2)]
    for log in broken:
        log.positions[:, 30:, 0] += 500 * np.arange(log.num_objects)[:, None]
    row = table(cut, broken)
    assert row["ade"] == pytest.approx(0)
    assert row["collision_simulated"] == table(cut, [cut])["collision_simulated"]


def test_history_is_not_measured():
    log = straight_log((0, 0, 0, 5), (0, 50, 0, 5))
    wild = log.positions.copy()
    wild[:, :6, 1] += np.array([3.0, -3, 3, -3, 3, -3])
    odd = dataclasses.replace(log, positions=wild)
    assert table(log, [odd], history=8)["linear_speed_likelihood"] == pytest.approx(
        table(log, [log], history=8)["linear_speed_likelihood"]
    )
    assert table(log, [odd])["ade"] > 0.1 > table(log, [odd], history=8)["ade"]


def test_traffic_light_violation_compares_rollouts_with_the_log():
    stop = np.full(41, Signal.STOP)
    waits, runs = (straight_log((0, 0, 0, speed), signal=stop) for speed in (2.0, 8.0))
    assert table(waits, [runs])["red_light_simulated"] == 1
    assert table(waits, [runs, waits])["traffic_light_violation_likelihood"] == pytest.approx(0.5)
    assert table(waits, [runs])["traffic_light_violation_likelihood"] < 1e-2


def test_features_that_are_not_defined_are_left_out():
    log = straight_log((0, 0, 0, 5), (0, 50, 0, 5), lanes=())
    row = table(log, [log])
    assert np.isnan(row["map_based_likelihood"]) and np.isnan(row["traffic_light_violation_likelihood"])
    defined = {name: weight for name, weight in WEIGHTS_2025.items() if name not in BUCKETS["map_based"]}
    expected = sum(weight * row[f"{name}_likelihood"] for name, weight in defined.items()) / sum(defined.values())
    assert row["metametric"] == pytest.approx(expected)


def test_sums_of_scenes_add_up_to_means():
    first, second = realism_of_motion(LOG, ROLLOUTS), realism_of_motion(traffic_log(1), [traffic_log(1)])
    both = realism_of_motion_table({name: first[name] + second[name] for name in first})
    one, two = realism_of_motion_table(first), realism_of_motion_table(second)
    assert both["metametric"] == pytest.approx((one["metametric"] + two["metametric"]) / 2)


@pytest.mark.parametrize(
    ("simulated", "options", "message"),
    [
        ([], {}, "no roll-outs"),
        ([LOG[:20]], {}, r"simulated\[0\] has 20 steps"),
        ([LOG, dataclasses.replace(LOG, timestamps=2 * LOG.timestamps)], {}, r"simulated\[1\] has 41 steps of 0.2 s"),
        ([LOG], {"history": 0}, "history is 0"),
        ([LOG], {"history": 41}, "history is 41"),
        ([LOG], {"weights": {"speed": 1.0}}, "unknown feature 'speed'"),
    ],
)
def test_realism_of_motion_refuses_with_a_cure(simulated, options, message):
    with pytest.raises(ValueError, match=message):
        realism_of_motion(LOG, simulated, **options)


def test_realism_of_motion_names_the_object_with_nan():
    positions = LOG.positions.copy()
    positions[3, 7, 0] = np.nan
    with pytest.raises(ValueError, match="object 3 has NaN or infinity at step 7"):
        realism_of_motion(LOG, [dataclasses.replace(LOG, positions=positions)])
