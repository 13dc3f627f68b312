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
        [
            x + np.cos(turn) * speed * time,
            y + np.sin(turn) * speed * time,
            np.broadcast_to(turn, (steps, len(x))),
            np.broadcast_to(speed, (steps, len(x))),
        ],
        -1,
    )
    agent_types = np.array([AgentType.VEHICLE] * len(x) if types is None else types)
    sizes = np.tile([4.0, 2.0], (len(x), 1))
    return Rollout(states.copy(), np.ones((steps, len(x)), bool), sizes, agent_types, signals=signals)


ROAD = scene(lanes=[lane((-200, 0), (200, 0))])


def test_collision_counts_both_vehicles():
    row = rollout_table(rollout_sums(straight((0, 0, 0, 10), (30, 0, 0, 0), (0, 50, 0, 0)), ROAD))
    assert row["ego_collision"] == 100 and row["collision"] == pytest.approx(200 / 3)
    safe = rollout_table(rollout_sums(straight((0, 0, 0, 10), (0, 3, 0, 10)), ROAD))
    assert safe["ego_collision"] == safe["collision"] == 0


def test_vehicle_collision_excludes_pedestrians():
    rollout = straight((0, 0, 0, 10), (30, 0, 0, 0), types=[AgentType.VEHICLE, AgentType.PEDESTRIAN])
    row = rollout_table(rollout_sums(rollout, ROAD))
    assert (row["collision"], row["vehicle_collision"]) == (100, 0)


def test_collision_ignores_absent_agents():
    rollout = straight((0, 0, 0, 10), (30, 0, 0, 0))
    rollout.valid[20:, 1] = False
    rollout.states[20:, 1] = np.nan
    row = rollout_table(rollout_sums(rollout, ROAD))
    assert row["collision"] == 0 and row["progress"] == pytest.approx((100 + 0) / 2)


def test_off_road_counts_vehicles_that_leave_the_road():
    row = rollout_table(rollout_sums(straight((0, 0, 0, 10), (0, 0, 45, 5), (0, 20, 0, 5)), ROAD))
    assert row["off_road"] == 50  # the third was never on it


@pytest.mark.parametrize(("state", "expected"), [(Signal.STOP, 100), (Signal.GO, 0), (Signal.UNKNOWN, 0)])
def test_red_light_counts_vehicles_that_enter_on_stop(state, expected):
    rollout = scene(lanes=[lane((-200, 0), (20, 0)), lane((20, 0), (60, 0))], joined=[(0, 1)])
    signals = np.zeros((STEPS, 2), int)
    signals[:, 1] = state
    row = rollout_table(rollout_sums(straight((0, 0, 0, 5), signals=signals), rollout))
    assert row["red_light"] == expected
    against = rollout_table(rollout_sums(straight((40, 0, 180, 5), signals=signals), rollout))
    waits = rollout_table(rollout_sums(straight((0, 0, 0, 1), signals=signals), rollout))
    assert against["red_light"] == waits["red_light"] == 0


def test_red_light_ignores_a_signal_that_turns_green():
    rollout = scene(lanes=[lane((-200, 0), (20, 0)), lane((20, 0), (60, 0))], joined=[(0, 1)])
    signals = np.zeros((STEPS, 2), int)
    signals[:, 1] = np.where(np.arange(STEPS) < 30, Signal.STOP, Signal.GO)
    assert rollout_table(rollout_sums(straight((0, 0, 0, 5), signals=signals), rollout))["red_light"] == 0


def test_stuck_counts_vehicles_that_stop_after_moving():
    rollout = straight((0, 0, 0, 5), (0, 9, 0, 0))
    rollout.states[30:, 0, 3] = 0
    assert rollout_table(rollout_sums(rollout, ROAD))["stuck"] == 50
    assert rollout_table(rollout_sums(straight((0, 0, 0, 5), steps=20), ROAD))["stuck"] == 0


def test_motion_table_is_zero_for_equal_rollouts():
    rng = np.random.default_rng(0)
    rollout = straight(*[(x, 0, 0, v) for x, v in rng.uniform(5, 40, (6, 2))])
    other = straight(*[(x, 0, 90, v) for x, v in rng.uniform(1, 9, (6, 2))])
    for mode in ("intended", "compat"):
        same = motion_table(motion_sums(rollout, mode), motion_sums(rollout, mode))
        assert all(value == pytest.approx(0, abs=1e-9) for value in same.values())
        different = motion_table(motion_sums(rollout, mode), motion_sums(other, mode))
        assert different["speed"] > 0.3 and all(value <= np.log(2) + 1e-9 for value in different.values())


def test_angular_speed_is_heading_only_in_compat_mode():
    east, north = straight((0, 0, 0, 5)), straight((0, 0, 90, 5))
    intended = motion_table(motion_sums(east), motion_sums(north))
    compat = motion_table(motion_sums(east, "compat"), motion_sums(north, "compat"))
    assert intended["angular_speed"] == pytest.approx(0, abs=1e-9)
    assert compat["angular_speed"] == pytest.approx(np.log(2))


def test_motion_sums_are_per_second():
    rollout = straight((0, 0, 0, 5))
    rollout.states[:, 0, 3] = np.arange(STEPS) * 0.1 * 1.05  # 1.05 m/s^2
    rollout.states[:, 0, 2] = np.deg2rad((np.arange(STEPS) * 0.1 * 20.3 + 180) % 360 - 180)
    sums = motion_sums(rollout)
    assert sums["acceleration_motion"].argmax() == int((1.05 + 10) / 0.1)
    assert sums["angular_speed_motion"].argmax() == int((20.3 + 50) / 0.5)
    assert sums["angular_speed_motion"].max() == STEPS - 1


def test_nearest_distance_is_empty_for_one_vehicle():
    assert motion_sums(straight((0, 0, 0, 5)))["nearest_motion"].sum() == 0
    assert np.isnan(motion_table(motion_sums(straight((0, 0, 0, 5))), motion_sums(straight((0, 0, 0, 5))))["nearest"])


def test_rollout_rejects_invalid_arrays():
    good = straight((0, 0, 0, 5))
    with pytest.raises(ValueError, match=r"states \[101, 1, 4\]"):
        Rollout(good.states[:5], good.valid, good.sizes, good.types)
    broken = good.states.copy()
    broken[3, 0, 1] = np.nan
    with pytest.raises(ValueError, match=r"states\[3, 0\] holds NaN"):
        Rollout(broken, good.valid, good.sizes, good.types)
    with pytest.raises(ValueError, match="dt is 0"):
        Rollout(good.states, good.valid, good.sizes, good.types, dt=0.0)
