import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.data.readers.opendrive.lane_lines import LaneKey
from scjax.scene import AgentType
from scjax.towns.lane_paths import LanePath
from scjax.towns.simulation import Drive
from scjax.towns.tracks import box_poses, drive_track, front_poses, walk_track


def _path(points, length: float) -> LanePath:
    points = np.column_stack([np.array(points, float), np.zeros(len(points))])
    arcs = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
    return LanePath((LaneKey("1", 0, -1),), points, arcs, np.array([0.0, length]), np.array([0.0, arcs[-1]]), 0.0)


PATHS = {
    "e_0": _path([[0, 0], [400, 0]], 400.0),
    "e_1": _path([[0, 3.5], [400, 3.5]], 400.0),
    "f_1": _path([[400, 3.5], [800, 3.5]], 400.0),
}


def _drive(lanes, positions, kind: str = "car.0") -> Drive:
    values = np.zeros((len(lanes), 6))
    values[:, 0] = 60 + 0.1 * np.arange(len(lanes))
    values[:, 4] = positions
    return Drive("v", kind, tuple(lanes), values)


def test_box_on_a_line_has_its_front_there():
    line = np.stack([np.linspace(0, 100, 101), np.zeros(101), np.linspace(0, 10, 101)], -1)
    center, heading = box_poses(line, line[:, 0], np.array([20.0, 50.0]), 8.0)
    np.testing.assert_allclose(center, [[16, 0, 1.6], [46, 0, 4.6]])
    np.testing.assert_allclose(heading, 0)


@given(st.floats(8.0, 60.0), st.floats(2.0, 16.0))
@settings(max_examples=20, deadline=None)
def test_box_on_a_circle_cuts_the_corner_by_less_than_half(radius, length):
    angles = np.linspace(0, np.pi, 2000)
    line = np.column_stack([radius * np.sin(angles), radius * (1 - np.cos(angles)), np.zeros(len(angles))])
    center, heading = box_poses(line, radius * angles, np.array([2.5 * radius]), length)
    half = length / (2 * radius)  # of the angle that the box spans
    outward = np.array([np.sin(2.5 - half), -np.cos(2.5 - half)])
    sagitta = radius * (1 - np.cos(half))
    assert (center[0, :2] - [0, radius]) @ outward == pytest.approx(radius - 0.4 * sagitta, abs=0.01)
    assert heading[0] == pytest.approx(2.5 - half, abs=1e-3)


@pytest.mark.parametrize("speed", [0.3, 2.0, 15.0])
def test_change_of_lanes_is_smooth_at_every_speed(speed):
    positions = 100 + speed * 0.1 * np.arange(190)
    front = front_poses(["e_0"] * 95 + ["e_1"] * 95, positions, PATHS)
    assert np.abs(np.diff(front[:, 1])).max() < 0.3 and front[94:96, 1].mean() == pytest.approx(1.75, abs=0.2)
    slope = np.abs(np.diff(front[:, 1]) / np.diff(front[:, 0])).max()
    assert slope < 0.6, "a car that creeps slides sideways"
    if speed > 1:
        np.testing.assert_allclose(front[[0, -1], 1], [0, 3.5], atol=1e-6)


def test_change_just_before_an_edge_ends_goes_on_behind_it():
    positions = np.concatenate([np.linspace(380, 394, 100), np.linspace(394.2, 399.8, 28), np.linspace(0, 30, 150)])
    front = front_poses(["e_0"] * 100 + ["e_1"] * 28 + ["f_1"] * 150, positions, PATHS)
    assert np.abs(np.diff(front[:, 1])).max() < 0.1 and front[-1, 1] == pytest.approx(3.5)
    assert front[128, 1] < 3.4  # still on its way where the edge ends


def test_drive_gives_a_track_on_the_lane():
    (track,) = drive_track(_drive(["e_0"] * 100, np.linspace(50, 149, 100)), PATHS, (4.0, 1.8, 1.5), 60.0, 1.0)
    assert track.agent_type == AgentType.VEHICLE and track.start == 0
    np.testing.assert_allclose(track.positions[10:-10, 1], 0, atol=1e-9)
    np.testing.assert_allclose(track.positions[10:-10, 0], np.linspace(50, 149, 100)[10:-10] - 2.0, atol=0.01)
    np.testing.assert_allclose(track.positions[:, 2], 0.75)
    np.testing.assert_allclose(np.hypot(*track.velocities[10:-10].T), 10.0, atol=0.01)


def test_cars_sway_around_their_place_aside():
    drive = _drive(["e_0"] * 280, np.linspace(20, 300, 280))
    (track,) = drive_track(drive, PATHS, (4.0, 1.8, 1.5), 60.0, 1.0, -0.2)
    aside = track.positions[:, 1]
    assert (aside > -0.31).all() and (aside < -0.09).all()
    assert aside.mean() == pytest.approx(-0.2, abs=0.01) and np.ptp(aside) > 0.15
    assert np.abs(track.headings).max() < 0.03


@pytest.mark.parametrize(("side", "y"), [(1.0, -0.9), (-1.0, 0.9)])
def test_cyclists_keep_to_the_side(side, y):
    drive = _drive(["e_0"] * 50, np.linspace(50, 70, 50), "bicycle.1")
    (track,) = drive_track(drive, PATHS, (1.8, 0.7, 1.7), 60.0, side)
    assert track.agent_type == AgentType.CYCLIST
    np.testing.assert_allclose(track.positions[:, 1], y, atol=1e-9)


def test_track_breaks_where_no_lane_of_ours_is():
    drive = _drive(["e_0"] * 40 + ["?"] * 5 + ["f_1"] * 40, np.linspace(0, 84, 85))
    first, second = drive_track(drive, PATHS, (4.0, 1.8, 1.5), 60.0, 1.0)
    assert (first.start, len(first.positions)) == (0, 40) and second.start == 45


def test_track_breaks_where_the_box_would_jump():
    positions = np.concatenate([np.linspace(50, 70, 60), np.linspace(120, 200, 200)])
    tracks = drive_track(_drive(["e_0"] * 260, positions), PATHS, (4.0, 1.8, 1.5), 60.0, 1.0)
    assert len(tracks) > 1 and len({track.name for track in tracks}) == len(tracks)
    for track in tracks:
        assert np.hypot(*np.diff(track.velocities, axis=0).T).max() < 4.0


def test_walk_stands_on_the_ground():
    values = np.zeros((30, 6))
    values[:, 0], values[:, 1], values[:, 3] = 61 + 0.1 * np.arange(30), np.linspace(0, 4, 30), 90.0
    track = walk_track(Drive("p", "", (), values), lambda xy: 2 + 0.1 * xy[:, 0], 60.0)
    assert track is not None and track.start == 10 and track.agent_type == AgentType.PEDESTRIAN
    np.testing.assert_allclose(track.headings, 0, atol=1e-9)
    np.testing.assert_allclose(track.positions[:, 2], 2.86 + 0.1 * track.positions[:, 0])
