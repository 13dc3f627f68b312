"""Which lanes follow each other: gaps, turns and heights of listed and inferred connections."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.data.join_options import JoinOptions
from scjax.data.lane_joins import inferred_joins, recorded_joins
from scjax.scene import MapLane


def _line(start, end, count=3):
    return np.linspace([*start, 0.0][:3], [*end, 0.0][:3], count)


def _lane(name, points, **fields):
    return MapLane(id=name, lane_type=None, points=points, **fields)


@pytest.mark.parametrize(("gap", "kept"), [(0.0, True), (0.9, True), (1.1, False), (16.0, False)])
def test_recorded_joins_refuse_open_connections(gap, kept):
    lines = [_line((0, 0), (10, 0)), _line((10 + gap, 0), (20 + gap, 0))]
    joins = recorded_joins([_lane("a", lines[0], successors=("b",)), _lane("b", lines[1])], lines)
    assert joins.pairs == ({(0, 1)} if kept else set())
    assert list(joins.warnings.values()) == ([] if kept else [1])


def test_recorded_joins_refuse_turns_and_steps():
    lines = [_line((0, 0), (10, 0)), _line((10, 0), (0, 1)), _line((10, 0, 5), (20, 0, 5))]
    lanes = [_lane("a", lines[0], successors=("b", "c", "gone")), _lane("b", lines[1]), _lane("c", lines[2])]
    joins = recorded_joins(lanes, lines)
    assert joins.pairs == set() and len(joins.warnings) == 2


def test_recorded_joins_note_ends_that_meet_unlisted():
    lines = [_line((0, 0), (10, 0)), _line((10, 0), (20, 0))]
    joins = recorded_joins([_lane("a", lines[0]), _lane("b", lines[1])], lines)
    assert joins.pairs == set() and list(joins.notes.values()) == [1]


@pytest.mark.parametrize(
    ("gap", "distance", "joined"), [(0.04, 0.05, True), (0.1, 0.05, False), (0.1, 0.2, True), (0.9, 1.0, True)]
)
def test_inferred_joins_up_to_the_distance(gap, distance, joined):
    lines = [_line((0, 0), (10, 0)), _line((10 + gap, 0), (20, 0))]
    joins = inferred_joins(lines, JoinOptions(distance))
    assert joins.pairs == ({(0, 1)} if joined else set())
    assert list(joins.notes.values()) == ([] if joined else [1])


@pytest.mark.parametrize("distance", [0.0, -1.0, 1.01, float("nan"), float("inf")])
def test_join_options_refuse_distances_out_of_range(distance):
    with pytest.raises(ValueError, match="join_distance is"):
        JoinOptions(distance)


@given(seed=st.integers(0, 10_000), distance=st.sampled_from([0.05, 0.3, 1.0]))
@settings(max_examples=50, deadline=None)
def test_no_joint_is_open_or_turns_back(seed, distance):
    """Listed or inferred, no connection is open by more than the tolerance or turns by more than 120 degrees."""
    rng = np.random.default_rng(seed)
    starts, turns = rng.uniform(-3, 3, (12, 2)), rng.uniform(-np.pi, np.pi, 12)
    lines = [_line(s, s + 4 * np.array([np.cos(t), np.sin(t)])) for s, t in zip(starts, turns, strict=True)]
    ids = [str(k) for k in range(12)]
    lanes = [_lane(k, line, successors=tuple(rng.choice(ids, 4))) for k, line in zip(ids, lines, strict=True)]
    for joins, limit in ((recorded_joins(lanes, lines), 1.0), (inferred_joins(lines, JoinOptions(distance)), distance)):
        for i, j in joins.pairs:
            assert np.hypot(*(lines[j][0] - lines[i][-1])[:2]) <= limit
            assert np.cos(turns[j] - turns[i]) >= np.cos(np.deg2rad(120.01))
