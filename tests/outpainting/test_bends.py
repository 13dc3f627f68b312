"""Lanes that are brought to open ends: no gap, no change of direction, and connected lanes stay connected."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from scjax.outpainting.bends import Bends, Joint
from scjax.outpainting.coverage import OpenEnd, outward_heading
from scjax.scene.angles import wrap_to_pi

ENDS = [(0.0, 0.0, 0.0), (0.8, 1.5, 0.3), (-1.0, -2.0, -0.5), (0.0, 2.5, 1.0)]
"""Place and direction of an open end, seen from the lane's start."""


def _line(*points):
    corners = np.array([(*point, 1.0) for point in points], np.float64)
    return np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(corners)])


def _end(x, y, turn, z=1.0):
    return OpenEnd("known", False, np.array([x, y, z]), float(turn), True)


def bend_lanes(lines, edges, joints):
    return Bends(lines, edges, joints).lines()


def _meets(lane, end, at_start=True):
    heading = outward_heading(lane, at_start)
    turn = np.rad2deg(abs(wrap_to_pi(heading + np.pi - end.outward)))
    return np.abs(lane[0 if at_start else -1] - end.place).max() < 1e-9 and turn < 5.0


def _is_smooth(lane, below=12.0):
    steps = np.diff(lane[:, :2], axis=0)
    lengths = np.hypot(*steps.T)
    turns = np.abs(wrap_to_pi(np.diff(np.arctan2(steps[:, 1], steps[:, 0]))))
    return lengths.min() > 1e-4 and np.rad2deg(turns.max()) < below


@pytest.mark.parametrize("at_start", [True, False])
@pytest.mark.parametrize(("x", "y", "turn"), ENDS)
def test_lanes_meet_their_ends_without_gap_or_turn(x, y, turn, at_start):
    lane = _line((0, 0), (40, 0))
    end = _end(x, y, turn, z=1.5)
    (bent,) = bend_lanes([lane if at_start else lane[::-1]], [], [Joint(0, at_start, end)])
    assert _meets(bent, end, at_start) and _is_smooth(bent)
    assert np.array_equal(bent[-1 if at_start else 0], lane[-1])


def test_lanes_that_fit_are_left_as_they_are():
    (bent,) = bend_lanes([_line((0, 0), (40, 0))], [], [Joint(0, True, _end(0, 0, 0))])
    assert np.abs(bent[:, 1]).max() < 1e-12


@pytest.mark.parametrize(("x", "y", "turn"), ENDS)
def test_bends_go_on_where_a_short_lane_splits_and_merges(x, y, turn):
    """Lane 0 is 2 m long; 1 and 2 follow it, 3 ends where it ends."""
    lines = [_line((0, 0), (2, 0)), _line((2, 0), (40, 0)), _line((2, 0), (30, 0), (40, 4)), _line((-40, -9), (2, 0))]
    edges = [(0, 1), (0, 2), (3, 1), (3, 2)]
    bent = bend_lanes(lines, edges, [Joint(0, True, _end(x, y, turn))])
    assert _meets(bent[0], _end(x, y, turn))
    for a, b in edges:
        assert np.abs(bent[a][-1] - bent[b][0]).max() < 1e-9
    whole = np.concatenate([bent[0], bent[1][1:]])
    assert _is_smooth(whole), "the two lanes follow one curve"
    assert all(np.array_equal(one[-1], other[-1]) for one, other in zip(bent[1:3], lines[1:3], strict=True))
    assert np.array_equal(bent[3][0], lines[3][0])


def test_joints_near_each_other_are_all_met():
    """Two short lanes merge into one; their open ends are moved alike, or apart."""
    lines = [_line((0, 0), (3, 1)), _line((0, 2), (3, 1)), _line((3, 1), (40, 1))]
    for shifts in ((1.0, 1.0), (0.6, -0.6), (0.0, 1.5)):
        ends = [_end(0.0, 0.0 + shifts[0], 0.3), _end(0.0, 2.0 + shifts[1], -0.3)]
        bent = bend_lanes(lines, [(0, 2), (1, 2)], [Joint(0, True, ends[0]), Joint(1, True, ends[1])])
        assert _meets(bent[0], ends[0]) and _meets(bent[1], ends[1])
        assert np.abs(bent[0][-1] - bent[2][0]).max() < 1e-9 > np.abs(bent[1][-1] - bent[2][0]).max()
    lines[:2] = _line((0, 0.9), (3, 1)), _line((0, 1.1), (3, 1))
    ends = [_end(0.0, 1.9, 0.03), _end(0.0, 2.1, -0.03)]
    bent = bend_lanes(lines, [(0, 2), (1, 2)], [Joint(k, True, end) for k, end in enumerate(ends)])
    assert all(_is_smooth(np.concatenate([one, bent[2][1:]])) for one in bent[:2])


def test_a_lane_between_two_joints_meets_both():
    lines = [_line((0, 0), (3, 0)), _line((3, 0), (6, 0))]
    ends = [_end(0, 0.5, 0.0), OpenEnd("other", True, np.array([6.0, -0.5, 1.0]), np.pi, True)]
    bent = bend_lanes(lines, [(0, 1)], [Joint(0, True, ends[0]), Joint(1, False, ends[1])])
    assert np.abs(bent[0][0] - ends[0].place).max() < 1e-9
    assert np.abs(bent[1][-1] - ends[1].place).max() < 1e-9
    assert np.abs(bent[0][-1] - bent[1][0]).max() < 1e-9


def test_lanes_in_a_ring_stay_connected():
    corners = [(0, 0), (4, 0), (4, 4), (0, 4)]
    lines = [_line(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)] + [_line((-6, 0), (0, 0))]
    edges = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 0)]
    bent = bend_lanes(lines, edges, [Joint(4, True, _end(-6.0, 1.0, 0.2))])
    assert _meets(bent[4], _end(-6.0, 1.0, 0.2))
    assert max(np.abs(bent[a][-1] - bent[b][0]).max() for a, b in edges) < 1e-9


def test_of_joints_at_one_place_the_first_counts():
    lines = [_line((-20, 0), (0, 0)), _line((0, 0), (20, 0))]
    joints = [Joint(1, True, _end(0, 1, 0)), Joint(0, False, _end(0, -1, 0))]
    bent = bend_lanes(lines, [(0, 1)], joints)
    assert np.array_equal(bent[0][-1], bent[1][0]) and bent[1][0][1] == 1.0


def test_unknown_heights_stay():
    lane = _line((0, 0), (40, 0))
    (bent,) = bend_lanes([lane], [], [Joint(0, True, _end(0, 1, 0, z=np.nan))])
    assert np.abs(bent[:, 2] - 1.0).max() < 1e-12
