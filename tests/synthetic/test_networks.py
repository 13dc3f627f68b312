"""Road networks: lanes join, do not touch by accident, and turn as wide as vehicles can."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from scjax.scene.polyline import cumulative_length
from scjax.synthetic.curves import STRAIGHT_END, line_length, resample_line, turn_curve
from scjax.synthetic.domains import DOMAINS
from scjax.synthetic.junctions import MAX_STOP_DISTANCE, InfeasiblePlan, stop_distances
from scjax.synthetic.network import Lane, Network
from scjax.synthetic.network_types import NETWORK_BUILDERS, draw_network

_NUM_NETWORKS = 8  # per network type
_BORDER = 90.0  # m from the center to where roads may end


@functools.cache
def networks_of(network_type: str) -> list[Network]:
    """Networks of one type, in the styles of all domains that have it."""
    styles = [domain.style for domain in DOMAINS if network_type in domain.networks]
    seeds = range(_NUM_NETWORKS)
    return [draw_network(network_type, styles[k % len(styles)], np.random.default_rng([3, k])) for k in seeds]


def max_bend(points: np.ndarray) -> float:
    """Largest change of direction between the segments of a line [rad]."""
    steps = np.diff(points, axis=0)
    headings = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    return float(np.abs(np.diff(headings)).max()) if len(headings) > 1 else 0.0


def is_near_center(point: np.ndarray) -> bool:
    return bool(np.abs(point).max() < _BORDER)


def has_way_back(lane: Lane, net: Network) -> bool:
    """Whether a lane in the other direction starts beside the end of ``lane``."""
    ahead = lane.points[-1] - lane.points[-2]
    return any(
        np.hypot(*(other.points[0] - lane.points[-1])) < 9.0 and ahead @ (other.points[1] - other.points[0]) < 0
        for other in net.lanes
    )


@pytest.mark.parametrize("network_type", NETWORK_BUILDERS)
def test_links_join_lanes_at_one_point(network_type):
    for net in networks_of(network_type):
        for lane in net.lanes:
            for successor in lane.successors:
                assert np.hypot(*(lane.points[-1] - net.lanes[successor].points[0])) < 1e-6


@pytest.mark.parametrize("network_type", NETWORK_BUILDERS)
def test_lanes_bend_gently_and_continue_their_direction(network_type):
    for net in networks_of(network_type):
        for lane in net.lanes:
            assert max_bend(resample_line(lane.points, 1.0)) < np.deg2rad(15)
            for successor in lane.successors:
                joint = np.concatenate([lane.points[-2:], net.lanes[successor].points[1:2]])
                assert max_bend(joint) < np.deg2rad(20)


@pytest.mark.parametrize("network_type", NETWORK_BUILDERS)
def test_lanes_near_the_center_continue_or_turn_back(network_type):
    for net in networks_of(network_type):
        with_predecessor = {successor for lane in net.lanes for successor in lane.successors}
        for k, lane in enumerate(net.lanes):
            if not lane.successors and is_near_center(lane.points[-1]):
                assert has_way_back(lane, net)
            if k not in with_predecessor and is_near_center(lane.points[0]):
                reverse = Lane(lane.points[::-1], lane.speed)
                backwards = Network([Lane(other.points[::-1], other.speed) for other in net.lanes])
                assert has_way_back(reverse, backwards)


@pytest.mark.parametrize("angle", np.deg2rad([-120.0, -90.0, -60.0, 60.0, 90.0, 120.0]))
def test_turn_curve_is_an_arc_between_straight_ends(angle):
    radius = 9.0
    reach = radius * np.tan(abs(angle) / 2) + STRAIGHT_END
    direction = np.array([np.cos(angle), np.sin(angle)])
    before = np.array([[-reach - 10.0, 0.0], [-reach, 0.0]])
    after = np.stack([reach * direction, (reach + 10.0) * direction])
    curve = turn_curve(before, after)
    np.testing.assert_allclose(curve[[0, -1]], [before[-1], after[0]], atol=1e-9)
    assert line_length(curve) == pytest.approx(radius * abs(angle) + 2 * STRAIGHT_END, rel=0.01)
    center = np.array([STRAIGHT_END - reach, np.sign(angle) * radius])
    arc = cumulative_length(curve)
    on_arc = curve[(arc > STRAIGHT_END + 0.5) & (arc < arc[-1] - STRAIGHT_END - 0.5)]
    np.testing.assert_allclose(np.hypot(*(on_arc - center).T), radius, atol=0.05)
    assert (np.diff(cumulative_length(curve)) > 0.5).all()


def test_stop_distances_leave_room_for_the_curb():
    half_width, radius = 3.5, 8.0
    angles = list(np.arange(4) * np.pi / 2)
    distances = stop_distances(angles, [half_width] * 4, [half_width] * 4, [radius] * 4)
    np.testing.assert_allclose(distances, half_width + radius + STRAIGHT_END)


def test_stop_distances_refuse_roads_that_are_too_wide():
    angles, half_widths = list(np.arange(4) * np.pi / 2), [MAX_STOP_DISTANCE - 5.0] * 4
    with pytest.raises(InfeasiblePlan, match="too wide"):
        stop_distances(angles, half_widths, half_widths, [8.0] * 4)


@pytest.mark.parametrize("network_type", ["crossing", "Y", "side streets", "blocks"])
def test_stop_lines_are_in_sight_of_the_center(network_type):
    for net in networks_of(network_type):
        for junction in net.junctions:
            assert all(arm.stop_distance <= MAX_STOP_DISTANCE for arm in junction.arms)
