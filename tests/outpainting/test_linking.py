"""New lanes at random before open ends of a map: connections without a gap, and with hardly a bend."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.outpainting.coverage import OpenEnd, outward_heading
from scjax.outpainting.linking import link_lanes, moved_lanes
from scjax.outpainting.seams import find_joints
from scjax.scene.angles import wrap_to_pi
from tests.factories.maps import map_lane

CASES = 100
NOBODY = np.zeros((0, 9)), np.zeros(0, np.int32)


def _arc(rng, length):
    """A lane of 20 points in a random place, with a random curve."""
    along = np.linspace(0.0, length, 20)
    middle = (along[1:] + along[:-1]) / 2
    heading = rng.uniform(-np.pi, np.pi) + rng.uniform(-1, 1) * min(1.2 / length, 0.15) * middle
    steps = np.stack([np.cos(heading), np.sin(heading)], -1) * np.diff(along)[:, None]
    places = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)]) + rng.uniform(-20, 20, 2)
    return np.concatenate([places, rng.uniform(-1, 1, (20, 1))], -1)


def _outward(points, is_start) -> float:
    heading = outward_heading(points, is_start)
    assert heading is not None
    return heading


def _known(rng, line, at_start, name, near=2.4, turn=59.0):
    """A lane of the map that ends up to 2.4 m and 59 degrees from where a new one begins, or begins where it ends."""
    distance, aside = near * rng.uniform() ** 0.5, rng.uniform(-np.pi, np.pi)
    place = line[0 if at_start else -1] + distance * np.array([np.cos(aside), np.sin(aside), 0.1])
    outward = _outward(line, at_start) + np.pi + np.deg2rad(rng.uniform(-turn, turn))
    far = place - 20.0 * np.array([np.cos(outward), np.sin(outward), 0.0])
    return map_lane(name, *map(tuple, (far, place) if at_start else (place, far)))


def _end(lane, is_start):
    return OpenEnd(lane.id, is_start, lane.points[0 if is_start else -1], _outward(lane.points, is_start), is_start)


def _gaps_and_bends(lines, listed, lanes, ends):
    """The number of joints, of those that are kept, and the gaps [m] and bends [rad] of these."""
    linked, _ = link_lanes(lines, listed, ends, *NOBODY)
    known = {lane.id: lane for lane in lanes}
    known |= moved_lanes(linked.lines, linked.joints, known)
    gaps, bends = [], []
    for joint in linked.joints:
        line, other = linked.lines[joint.lane], known[joint.open_end.lane_id].points
        gaps.append(np.abs(line[0 if joint.at_start else -1] - other[-1 if joint.at_start else 0]).max())
        headings = _outward(line, joint.at_start), _outward(other, not joint.at_start)
        bends.append(abs(wrap_to_pi(headings[0] + np.pi - headings[1])))
    return len(find_joints(lines, ends, listed)), len(linked.joints), gaps, bends


@pytest.mark.parametrize("between", [False, True])
@pytest.mark.parametrize(("shortest", "longest"), [(0.5, 8.0), (10.0, 40.0)])
def test_connections_have_no_gap_and_bend_by_less_than_5_degrees(shortest, longest, between):
    rng = np.random.default_rng(0)
    found = kept = 0
    for _ in range(CASES):
        line = _arc(rng, rng.uniform(shortest, longest))
        lanes = [_known(rng, line, True, "before")] + [_known(rng, line, False, "behind")] * between
        ends = [_end(lane, lane.id == "behind") for lane in lanes]
        one_found, one_kept, gaps, bends = _gaps_and_bends([line], [], lanes, ends)
        found, kept = found + one_found, kept + one_kept
        assert max(gaps, default=0.0) == 0.0 and np.rad2deg(max(bends, default=0.0)) < 5.0
    assert found == CASES * (1 + between)
    if shortest >= 10.0:
        assert kept == found, "long lanes can bend as far as joints allow"
    elif not between:
        assert kept >= 0.99 * found


def test_lanes_that_share_a_place_are_joined_there_exactly():
    """Lanes of the map that nearly meet are one road beyond: one is moved to the other."""
    rng = np.random.default_rng(1)
    for _ in range(CASES):
        line = _arc(rng, rng.uniform(3.0, 30.0))
        one = _known(rng, line, True, "one")
        other = map_lane("other", *map(tuple, one.points + rng.uniform(-0.02, 0.02, 3)))
        _, kept, gaps, bends = _gaps_and_bends([line], [], [one, other], [_end(one, False), _end(other, False)])
        assert kept == 2 and max(gaps) == 0.0 and np.rad2deg(max(bends)) < 5.0


def test_connected_lanes_are_equal_where_they_meet():
    rng, edges = np.random.default_rng(2), 0
    for _ in range(CASES):
        line, cut = _arc(rng, rng.uniform(20.0, 40.0)), rng.integers(4, 17)
        after = line[cut:] + rng.uniform(-0.4, 0.4, 3)
        lane = _known(rng, line, True, "before")
        linked, _ = link_lanes([line[: cut + 1], after], [(0, 1)], [_end(lane, False)], *NOBODY)
        edges += len(linked.edges)
        assert all(np.array_equal(linked.lines[a][-1], linked.lines[b][0]) for a, b in linked.edges)
    assert edges == CASES
