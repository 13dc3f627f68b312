"""Driving of logs by hand: who collides, leaves the road, runs a light, is stuck; how far vehicles drive."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.metrics.closed_loop import motion_sums
from scjax.metrics.driving import driving_sums, driving_table, rollout_of_log
from scjax.scene import AgentType, Signal
from tests.factories.motion_logs import moved_log, road, select_objects, straight_log, traffic_log, with_ghosts

LONG = 151  # steps, 15 s


def table(log):
    return driving_table(driving_sums(log))


def test_collision_counts_both_vehicles():
    row = table(straight_log((0, 0, 0, 10), (30, 0, 0, 0), (0, 50, 0, 0)))
    assert row["scenes_collision"] == row["ego_collision"] == 100
    assert row["collision"] == row["vehicle_collision"] == pytest.approx(200 / 3)
    safe = table(straight_log((0, 0, 0, 10), (0, 3, 0, 10)))
    assert safe["scenes_collision"] == safe["collision"] == 0


def test_collision_leaves_out_pairs_that_overlap_at_the_first_step():
    hitch = straight_log((0, 0, 0, 10), (-3.5, 0, 0, 10))
    assert table(hitch)["collision"] == 0
    later = table(straight_log((0, 0, 0, 10), (-3.5, 0, 0, 10), (30, 0, 0, 0)))
    assert later["collision"] == 100, "a third object that the pair hits counts"
    joins = dataclasses.replace(hitch, valid=hitch.valid & (np.arange(41) > [[-1], [4]]))
    assert table(joins)["collision"] == 100, "a pair that begins to overlap later counts"


def test_vehicle_collision_excludes_pedestrians():
    log = straight_log((0, 0, 0, 10), (30, 0, 0, 0), types=[AgentType.VEHICLE, AgentType.PEDESTRIAN])
    row = table(log)
    assert (row["collision"], row["vehicle_collision"]) == (100, 0)


def test_collisions_are_those_of_blocks_of_any_size(monkeypatch):
    log = traffic_log(4, objects=16)
    whole = driving_sums(log)
    monkeypatch.setattr("scjax.metrics.driving._BLOCK", 1)
    np.testing.assert_array_equal(driving_sums(log)["collision"], whole["collision"])
    assert whole["collision"][0] > 0


def test_off_road_counts_vehicles_that_leave_the_road():
    row = table(straight_log((0, 0, 0, 10), (0, 0, 45, 5), (0, 20, 0, 5)))
    assert row["off_road"] == 50, "the third was never on it"
    assert np.isnan(table(straight_log((0, 0, 0, 10), lanes=()))["off_road"])


@pytest.mark.parametrize(("state", "expected"), [(Signal.STOP, 100), (Signal.GO, 0), (Signal.UNKNOWN, 0)])
def test_red_light_counts_fronts_that_cross_the_stop_point(state, expected):
    signal = np.full(41, state)
    assert table(straight_log((0, 0, 0, 4.6), signal=signal))["red_light"] == expected, "the center stays behind"
    assert table(straight_log((0, 0, 0, 4.4), signal=signal))["red_light"] == 0
    assert table(straight_log((40, 0, 180, 8), signal=signal))["red_light"] == 0, "oncoming"
    assert table(straight_log((0, 2.5, 0, 8), signal=signal))["red_light"] == 0, "on another lane"


def test_red_light_ignores_a_signal_that_turns_green():
    signal = np.where(np.arange(41) < 20, Signal.STOP, Signal.GO)
    assert table(straight_log((0, 0, 0, 6), signal=signal))["red_light"] == 0


def test_red_light_uses_the_recorded_stop_point():
    log = straight_log((0, 0, 0, 6), signal=np.full(41, Signal.STOP))
    far = dataclasses.replace(log, signal_positions=np.array([[40.0, 0.0, 0.0]]))
    assert (table(log)["red_light"], table(far)["red_light"]) == (100, 0)


def test_red_light_needs_all_signals_of_a_place_to_be_stop():
    log = straight_log((0, 0, 0, 8), signal=np.full(41, Signal.STOP))
    for other, expected in ((Signal.GO, 0), (Signal.STOP, 100)):
        both = dataclasses.replace(
            log,
            lanes=(*log.lanes, road("c", 20, 80)),
            signal_lane_ids=("b", "c"),
            signal_states=np.stack([log.signal_states[0], np.full(41, other)]),
            signal_positions=np.full((2, 3), np.nan),
        )
        assert table(both)["red_light"] == expected


def standing(log, since, rows=(0,)):
    """The log whose objects stop at a step."""
    positions, velocities = log.positions.copy(), log.velocities.copy()
    for row in rows:
        positions[row, since:] = positions[row, since]
        velocities[row, since:] = 0
    return dataclasses.replace(log, positions=positions, velocities=velocities)


def test_stuck_counts_vehicles_that_stand_without_a_reason():
    assert table(standing(straight_log((0, 0, 0, 3), steps=LONG), 30))["stuck"] == 100
    assert table(standing(straight_log((0, 0, 0, 3), steps=LONG), 60))["stuck"] == 0, "9 s are not long enough"
    assert np.isnan(table(straight_log((0, 0, 0, 0), steps=41))["stuck"])


@pytest.mark.parametrize(("state", "expected"), [(Signal.STOP, 0), (Signal.CAUTION, 0), (Signal.GO, 100)])
def test_stuck_excuses_vehicles_at_a_red_signal(state, expected):
    log = straight_log((5, 0, 0, 3), steps=LONG, signal=np.full(LONG, state))
    assert table(standing(log, 30))["stuck"] == expected


def test_stuck_excuses_vehicles_behind_a_leader():
    ahead, beside = ((14 + 5, 0, 0, 0), (14 + 5, 3.0, 0, 0))
    for other, expected in ((ahead, 0), (beside, 100)):
        log = standing(straight_log((0, 0, 0, 3), other, steps=LONG, types=[0, AgentType.STATIC]), 30)
        assert table(log)["stuck"] == expected


def test_stuck_ignores_vehicles_that_park_beside_the_lane():
    assert table(straight_log((0, 2.4, 0, 0), steps=LONG))["stuck"] == 0
    assert table(straight_log((0, 0.3, 0, 0), steps=LONG))["stuck"] == 100, "in the way since the start"


def test_progress_is_the_path_of_vehicles():
    row = table(straight_log((0, 0, 0, 10), (0, 50, 90, 5), (0, 90, 0, 9), types=[0, 0, AgentType.PEDESTRIAN]))
    assert row["progress"] == pytest.approx((40 + 20) / 2)
    assert row["progress_speed"] == pytest.approx(7.5)
    shaking = straight_log((0, 0, 0, 0))
    shaking.positions[0, ::2, 0] += 0.005
    assert table(shaking)["progress"] == 0


def test_infeasible_counts_hard_braking_and_tight_turns():
    log = straight_log((0, 0, 0, 10))
    assert table(log)["infeasible"] == 0
    assert table(standing(log, 20))["infeasible"] > 0
    headings = log.headings.copy()
    headings[0] = np.arange(41) * 0.4
    assert table(dataclasses.replace(log, headings=headings))["infeasible"] == 100


@pytest.mark.parametrize("seed", range(3))
def test_driving_does_not_depend_on_order_padding_or_place(seed):
    log = traffic_log(seed, steps=121)
    expected = table(log)
    order = np.random.default_rng(seed).permutation(log.num_objects).tolist()
    for other in (select_objects(log, order), with_ghosts(log, 3), moved_log(log, 2.1, (900.0, -3000.0))):
        assert table(other) == pytest.approx(expected, nan_ok=True)


def test_rollout_of_log_begins_with_the_ego():
    log = dataclasses.replace(traffic_log(0), ego_index=3)
    rollout = rollout_of_log(log)
    np.testing.assert_array_equal(rollout.states[:, 0, :2], log.positions[3, :, :2])
    np.testing.assert_array_equal(rollout.states[:, 1, :2], log.positions[0, :, :2])
    np.testing.assert_array_equal(rollout.valid.sum(), log.valid.sum())
    vehicles = log.object_types == AgentType.VEHICLE
    assert motion_sums(rollout)["speed_motion"].sum() == log.valid[vehicles].sum()


def test_driving_refuses_logs_without_motion():
    with pytest.raises(ValueError, match="the log has 1 step"):
        driving_sums(straight_log((0, 0, 0, 1), steps=1))
