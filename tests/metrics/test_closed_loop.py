"""Roll-outs by hand: who collides, leaves the road, runs a light, gets stuck; histograms of motion in both modes."""

import numpy as np
import pytest

from scjax.metrics.closed_loop import Rollout, motion_sums, motion_table, rollout_sums, rollout_table
from scjax.scene import AgentType, Signal
from tests.factories.traffic import lane, scene

STEPS = 101  # 10 s


def straight(*tracks, steps=STEPS, types=None, signals=None):
    """Agents that drive straight on: (x, y, heading in degrees, speed)."""
    time = np.arange(steps)[:, None] * 0.1
    x, y, heading, speed = (np.array(column, float) for column in zip(*tracks, strict=True))
    turn = np.deg2rad(heading)
    states = np.stack(
        [x + np.cos(turn) * speed * time, y + np.sin(turn) * speed * time,
         np.broadcast_to(turn, (steps, len(x))), np.broadcast_to(speed, (steps, len(x)))], -1
    )  # fmt: skip
    kinds = np.array([AgentType.VEHICLE] * len(x) if types is None else types)
    sizes = np.tile([4.0, 2.0], (len(x), 1))
    return Rollout(states.copy(), np.ones((steps, len(x)), bool), sizes, kinds, signals=signals)


ROAD = scene(lanes=[lane((-200, 0), (200, 0))])


def test_a_rear_end_collision_counts_both_and_only_them():
    row = rollout_table(rollout_sums(straight((0, 0, 0, 10), (30, 0, 0, 0), (0, 50, 0, 0)), ROAD))
    assert row["ego_collision"] == 100 and row["collision"] == pytest.approx(200 / 3)
    safe = rollout_table(rollout_sums(straight((0, 0, 0, 10), (0, 3, 0, 10)), ROAD))
    assert safe["ego_collision"] == safe["collision"] == 0


def test_people_count_in_collisions_of_all_and_not_of_vehicles():
    made = straight((0, 0, 0, 10), (30, 0, 0, 0), types=[AgentType.VEHICLE, AgentType.PEDESTRIAN])
    row = rollout_table(rollout_sums(made, ROAD))
    assert (row["collision"], row["vehicle_collision"]) == (100, 0)


def test_agents_that_are_not_there_hit_nobody():
    made = straight((0, 0, 0, 10), (30, 0, 0, 0))
    made.valid[20:, 1] = False
    made.states[20:, 1] = np.nan
    row = rollout_table(rollout_sums(made, ROAD))
    assert row["collision"] == 0 and row["progress"] == pytest.approx((100 + 0) / 2)


def test_leaving_the_road():
    row = rollout_table(rollout_sums(straight((0, 0, 0, 10), (0, 0, 45, 5), (0, 20, 0, 5)), ROAD))
    assert row["off_road"] == 50  # the third was never on it


@pytest.mark.parametrize(("state", "expected"), [(Signal.STOP, 100), (Signal.GO, 0), (Signal.UNKNOWN, 0)])
def test_running_a_red_light(state, expected):
    made = scene(lanes=[lane((-200, 0), (20, 0)), lane((20, 0), (60, 0))], joined=[(0, 1)])
    signals = np.zeros((STEPS, 2), int)
    signals[:, 1] = state
    row = rollout_table(rollout_sums(straight((0, 0, 0, 5), signals=signals), made))
    assert row["red_light"] == expected
    against = rollout_table(rollout_sums(straight((40, 0, 180, 5), signals=signals), made))
    waits = rollout_table(rollout_sums(straight((0, 0, 0, 1), signals=signals), made))
    assert against["red_light"] == waits["red_light"] == 0


def test_a_light_that_turns_green_in_time():
    made = scene(lanes=[lane((-200, 0), (20, 0)), lane((20, 0), (60, 0))], joined=[(0, 1)])
    signals = np.zeros((STEPS, 2), int)
    signals[:, 1] = np.where(np.arange(STEPS) < 30, Signal.STOP, Signal.GO)
    assert rollout_table(rollout_sums(straight((0, 0, 0, 5), signals=signals), made))["red_light"] == 0


def test_stuck_is_standing_after_having_moved():
    made = straight((0, 0, 0, 5), (0, 9, 0, 0))
    made.states[30:, 0, 3] = 0
    assert rollout_table(rollout_sums(made, ROAD))["stuck"] == 50
    assert rollout_table(rollout_sums(straight((0, 0, 0, 5), steps=20), ROAD))["stuck"] == 0


def test_motion_of_equal_rollouts_does_not_differ():
    rng = np.random.default_rng(0)
    made = straight(*[(x, 0, 0, v) for x, v in rng.uniform(5, 40, (6, 2))])
    other = straight(*[(x, 0, 90, v) for x, v in rng.uniform(1, 9, (6, 2))])
    for mode in ("intended", "compat"):
        same = motion_table(motion_sums(made, mode), motion_sums(made, mode))
        assert all(value == pytest.approx(0, abs=1e-9) for value in same.values())
        apart = motion_table(motion_sums(made, mode), motion_sums(other, mode))
        assert apart["speed"] > 0.3 and all(value <= np.log(2) + 1e-9 for value in apart.values())


def test_only_the_compat_mode_mistakes_heading_for_turning():
    east, north = straight((0, 0, 0, 5)), straight((0, 0, 90, 5))
    intended = motion_table(motion_sums(east), motion_sums(north))
    compat = motion_table(motion_sums(east, "compat"), motion_sums(north, "compat"))
    assert intended["angular_speed"] == pytest.approx(0, abs=1e-9)
    assert compat["angular_speed"] == pytest.approx(np.log(2))


def test_acceleration_and_turn_rate_are_per_second():
    made = straight((0, 0, 0, 5))
    made.states[:, 0, 3] = np.arange(STEPS) * 0.1 * 1.05  # 1.05 m/s^2
    made.states[:, 0, 2] = np.deg2rad((np.arange(STEPS) * 0.1 * 20.3 + 180) % 360 - 180)
    sums = motion_sums(made)
    assert sums["acceleration_motion"].argmax() == int((1.05 + 10) / 0.1)
    assert sums["angular_speed_motion"].argmax() == int((20.3 + 50) / 0.5)
    assert sums["angular_speed_motion"].max() == STEPS - 1


def test_a_vehicle_alone_has_no_neighbour():
    assert motion_sums(straight((0, 0, 0, 5)))["nearest_motion"].sum() == 0
    assert np.isnan(motion_table(motion_sums(straight((0, 0, 0, 5))), motion_sums(straight((0, 0, 0, 5))))["nearest"])


def test_bad_arrays_are_named():
    good = straight((0, 0, 0, 5))
    with pytest.raises(ValueError, match=r"states \[101, 1, 4\]"):
        Rollout(good.states[:5], good.valid, good.sizes, good.types)
    broken = good.states.copy()
    broken[3, 0, 1] = np.nan
    with pytest.raises(ValueError, match=r"states\[3, 0\] holds NaN"):
        Rollout(broken, good.valid, good.sizes, good.types)
    with pytest.raises(ValueError, match="dt is 0"):
        Rollout(good.states, good.valid, good.sizes, good.types, dt=0.0)
