import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

from scjax.data import ragged

WINDOW = (-32.0, 32.0, -32.0, 32.0)
seeds = st.integers(0, 2**32 - 1)


def walks(seed, count=5, step=8.0, snap=False):
    """Random polylines that leave and enter the window; with ``snap``, vertices often lie exactly on its border."""
    rng = np.random.default_rng(seed)
    lines = []
    for _ in range(count):
        steps = rng.normal(0, step, (rng.integers(2, 40), 3)) * [1, 1, 0.1]
        line = np.cumsum(steps, 0) + rng.uniform(-40, 40, 3) * [1, 1, 0.1]
        if snap:
            line = np.round(line / 16) * 16
            line = line[np.concatenate([[True], (np.diff(line[:, :2], axis=0) != 0).any(1)])]
        lines.append(line if len(line) > 1 else np.array([[0.0, 0, 0], [5, 5, 0]]))
    return lines


def joined(lines):
    return np.concatenate(lines), np.concatenate([[0], np.cumsum([len(line) for line in lines])])


def split(pieces):
    return np.split(pieces.points, pieces.offsets[1:-1]) if len(pieces.source) else []  # one empty part otherwise


@given(seeds, st.booleans())
@settings(max_examples=150, deadline=None)
def test_clip_agrees_with_shapely(seed, snap):
    lines = walks(seed, snap=snap)
    pieces = ragged.clip_polylines(*joined(lines), WINDOW, min_length=0.0)
    assert (np.abs(pieces.points[:, :2]) <= 32).all()
    box = shapely.box(-32, -32, 32, 32)
    for index, line in enumerate(lines):
        own = [p for p, source in zip(split(pieces), pieces.source, strict=True) if source == index]
        total = sum(np.hypot(*np.diff(p[:, :2], axis=0).T).sum() for p in own)
        segments = [shapely.LineString(line[i : i + 2, :2]) for i in range(len(line) - 1)]
        assert total == pytest.approx(sum(s.intersection(box).length for s in segments), abs=1e-6)
        curve = shapely.LineString(line[:, :2])
        assert all(curve.distance(shapely.Point(p)) < 1e-9 for piece in own for p in piece[:, :2])
    arcs = [np.hypot(*np.diff(p[:, :2], axis=0).T).sum() for p in split(pieces)]
    np.testing.assert_allclose(pieces.arc[:, 1] - pieces.arc[:, 0], arcs, atol=1e-6)


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_clip_is_idempotent(seed):
    points, offsets = joined(walks(seed))
    once = ragged.clip_polylines(points, offsets, WINDOW)
    twice = ragged.clip_polylines(once.points, once.offsets, WINDOW)
    np.testing.assert_allclose(ragged.resample_pieces(once, 20), ragged.resample_pieces(twice, 20), atol=1e-6)


@given(seeds, st.booleans())
@example(27387017, True)  # nothing lies inside
@settings(max_examples=150, deadline=None)
def test_clip_cut_separates_sides(seed, snap):
    lines = walks(seed, snap=snap)
    whole, cut = (ragged.clip_polylines(*joined(lines), WINDOW, cut=flag) for flag in (False, True))
    for piece, follows in zip(split(cut), cut.follows, strict=True):
        assert (piece[:, 0] <= 0).all() or (piece[:, 0] >= 0).all()
        assert not follows or abs(piece[0, 0]) < ragged.MIN_PIECE_LENGTH
    # Short parts may go, their runs may not; ends of polylines stay reachable.
    assert (~cut.follows).sum() == len(whole.source)
    assert set(cut.source[cut.has_start]) == set(whole.source[whole.has_start])
    assert set(cut.source[cut.has_end]) == set(whole.source[whole.has_end])
    lost = (whole.arc[:, 1] - whole.arc[:, 0]).sum() - (cut.arc[:, 1] - cut.arc[:, 0]).sum()
    crossings = sum((line[:-1, 0] * line[1:, 0] <= 0).sum() for line in lines)
    assert -1e-6 <= lost <= ragged.MIN_PIECE_LENGTH * crossings


def test_clip_returning_lane_gives_two_pieces():
    line = np.array([[0.0, 20, 0], [0, 40, 2], [10, 40, 3], [10, 20, 5]])
    pieces = ragged.clip_polylines(*joined([line]), WINDOW)
    assert pieces.source.tolist() == [0, 0]
    assert pieces.has_start.tolist() == [True, False] and pieces.has_end.tolist() == [False, True]
    np.testing.assert_allclose(split(pieces)[0], [[0, 20, 0], [0, 32, 1.2]])
    np.testing.assert_allclose(pieces.arc, [[0, 12], [38, 50]])


@pytest.mark.parametrize(("length", "count"), [(0.49, 0), (0.51, 1)])
def test_clip_drops_short_pieces(length, count):
    line = np.array([[32.0 - length, 0, 0], [40, 0, 0]])
    assert len(ragged.clip_polylines(*joined([line]), WINDOW).source) == count


def test_clip_keeps_short_whole_lanes():
    pieces = ragged.clip_polylines(*joined([np.array([[0.0, 0, 0], [0.2, 0, 0]])]), WINDOW)
    assert pieces.has_start.all() and pieces.has_end.all() and len(pieces.source) == 1


def test_clip_empty_window_and_corner():
    lines = [np.array([[40.0, 0, 0], [50, 0, 0]]), np.array([[64.0, 0, 0], [0, 64, 0]])]
    pieces = ragged.clip_polylines(*joined(lines), WINDOW, cut=True)
    assert len(pieces.source) == 0 and ragged.resample_pieces(pieces, 20).shape == (0, 20, 3)
    assert ragged.piece_successors(pieces, np.array([[0, 1]]), 2).shape == (0, 2)


def test_clip_short_part_keeps_links():
    before, line = np.array([[-20.0, 0, 0], [-0.2, 0, 0]]), np.array([[-0.2, 0, 0], [20, 0, 0]])
    pieces = ragged.clip_polylines(*joined([before, line]), WINDOW, cut=True)
    assert len(pieces.source) == 2 and split(pieces)[1][0, 0] == 0.0
    assert ragged.piece_successors(pieces, np.array([[0, 1]]), 2).tolist() == [[0, 1]]


def test_piece_successors_need_true_ends():
    lines = [np.array([[0.0, 0, 0], [50, 0, 0]]), np.array([[50.0, 0, 0], [50, 9, 0], [0, 9, 0]])]
    pieces = ragged.clip_polylines(*joined(lines), WINDOW)
    assert len(pieces.source) == 2
    assert len(ragged.piece_successors(pieces, np.array([[0, 1]]), 2)) == 0
    assert ragged.piece_successors(pieces, np.array([[1, 0]]), 2).tolist() == [[1, 0]]


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_resample_pieces_agrees_with_interp(seed):
    pieces = ragged.clip_polylines(*joined(walks(seed)), (-1e3, 1e3, -1e3, 1e3))
    for piece, actual in zip(split(pieces), ragged.resample_pieces(pieces, 20), strict=True):
        arc = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(piece[:, :2], axis=0).T))])
        expected = np.stack([np.interp(np.linspace(0, arc[-1], 20), arc, piece[:, k]) for k in range(3)], -1)
        np.testing.assert_allclose(actual, expected, atol=1e-6)


@given(seeds, st.sampled_from([1e-3, 0.1, 2.0]))
@settings(max_examples=60, deadline=None)
def test_simplify_stays_within_tolerance(seed, tolerance):
    lines = walks(seed, step=1.0)
    points, offsets = ragged.simplify_polylines(*joined(lines), tolerance)
    for line, thin in zip(lines, np.split(points, offsets[1:-1]), strict=True):
        np.testing.assert_array_equal(thin[[0, -1]], line[[0, -1]])
        curve = shapely.LineString(thin[:, :2])
        assert max(curve.distance(shapely.Point(p)) for p in line[:, :2]) <= tolerance + 1e-9
        full, short = (np.hypot(*np.diff(p[:, :2], axis=0).T).sum() for p in (line, thin))
        assert full * (1 - 2 * ragged.MAX_SHORTENING) <= short <= full + 1e-9


def test_simplify_straight_line():
    line = np.stack([np.linspace(0, 50, 101), np.linspace(3, 4, 101), np.full(101, np.nan)], -1)
    points, offsets = ragged.simplify_polylines(*joined([line, line + 1]), 1e-4)
    assert len(points) == 4 and offsets.tolist() == [0, 2, 4] and np.isnan(points[:, 2]).all()
