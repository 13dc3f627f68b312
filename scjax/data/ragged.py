"""Ragged polylines: polyline i is ``points[offsets[i]:offsets[i + 1]]``.

Every function works on all polylines at once, without a Python loop over lanes: these functions take most of the time
of a training example.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

MAX_SHORTENING = 5e-6  # share of a lane's length that simplification may remove
MIN_PIECE_LENGTH = 0.5  # m; shorter pieces of a lane are dropped (evaluation rule, step 5)


@dataclasses.dataclass(frozen=True)
class ClippedPolylines:
    """Pieces of polylines inside a window, in the order of the polylines and along each.

    Attributes:
      points, offsets: the pieces as ragged polylines.
      source: index of the polyline each piece was cut from.
      arc: where the piece starts and ends on that polyline, in xy arc length [m].
      has_start, has_end: whether the piece includes the first / last point of the polyline.
      follows: whether the piece continues the one before it after a cut at x = 0.
      point_arc: position of each point on its polyline, in xy arc length [m].
    """

    points: Float[np.ndarray, "points 3"]
    offsets: Int[np.ndarray, " offsets"]
    source: Int[np.ndarray, " pieces"]
    arc: Float64[np.ndarray, "pieces 2"]
    has_start: Bool[np.ndarray, " pieces"]
    has_end: Bool[np.ndarray, " pieces"]
    follows: Bool[np.ndarray, " pieces"]
    point_arc: Float64[np.ndarray, " points"]


def arc_lengths(points: Float[np.ndarray, "points 3"], offsets: Int[np.ndarray, " offsets"]) -> np.ndarray:
    """xy arc length from the start of its polyline to each point, [points], float64 [m]."""
    total = _running_length(np.array(points.T, np.float64), offsets)
    return total - np.repeat(total[offsets[:-1]], np.diff(offsets))


def clip_polylines(
    points: Float[np.ndarray, "points 3"],
    offsets: Int[np.ndarray, " offsets"],
    window: tuple[float, float, float, float],
    *,
    cut: bool = False,
    min_length: float = MIN_PIECE_LENGTH,
) -> ClippedPolylines:
    """Exact clipping of every segment to the closed window (x_min, x_max, y_min, y_max).

    A polyline that leaves and returns gives several pieces.

    Args:
      cut: cut every piece again where it crosses x = 0. Parts shorter than ``min_length`` are then dropped, except the
        longest of each piece; the part next to a dropped one takes its place in the chain.
      min_length: shorter pieces are dropped unless they are whole polylines [m].
    """
    xyz = np.array(points.T, np.float64, order="C")
    arc = _running_length(xyz, offsets)
    x, y, _ = xyz
    x_min, x_max, y_min, y_max = window
    code = (x < x_min).view(np.uint8) | ((x > x_max).view(np.uint8) << 1)
    code |= ((y < y_min).view(np.uint8) << 2) | ((y > y_max).view(np.uint8) << 3)
    candidate = (code[:-1] & code[1:]) == 0
    candidate[offsets[1:-1] - 1] = False  # from one polyline to the next is no segment
    first = candidate.nonzero()[0]
    source = offsets.searchsorted(first, side="right") - 1
    starts_inside, ends_inside = code[first] == 0, code[first + 1] == 0
    # One column per segment: start xyz, end xyz, arc at the start, arc at the end.
    segments = np.empty((8, len(first)))
    segments[:3], segments[3:6] = xyz[:, first], xyz[:, first + 1]
    base = arc[offsets[source]]
    segments[6], segments[7] = arc[first] - base, arc[first + 1] - base
    crossing = (~(starts_inside & ends_inside)).nonzero()[0]
    if crossing.size:
        shortened, inside = _clip_segments(segments[:, crossing], window)
        segments[:, crossing] = shortened
        if not inside.all():
            rows = np.ones(len(first), bool)
            rows[crossing] = inside
            segments, first, source = segments[:, rows], first[rows], source[rows]
            starts_inside, ends_inside = starts_inside[rows], ends_inside[rows]
    at_start = (first == offsets[source]) & starts_inside
    at_end = (first + 2 == offsets[source + 1]) & ends_inside
    starts_run = np.ones(len(first), bool)  # a run is a piece before any cut at x = 0
    starts_run[1:] = ~ends_inside[:-1] | ~starts_inside[1:] | (first[1:] != first[:-1] + 1)

    head, tail = _group_bounds(starts_run)
    keep = (segments[7, tail] - segments[6, head] >= min_length) | (at_start[head] & at_end[tail])
    if not keep.all():
        rows = keep.repeat(tail - head + 1)
        segments, source, starts_run = segments[:, rows], source[rows], starts_run[rows]
        head, tail = head[keep], tail[keep]
    run_start, run_end = at_start[head], at_end[tail]
    starts_part, run = starts_run, starts_run.cumsum() - 1
    if cut and len(source):
        segments, origin = _split_at_zero(segments)
        first_copy = np.ones(len(origin), bool)
        first_copy[1:] = origin[1:] != origin[:-1]
        source, run, starts_run = source[origin], run[origin], starts_run[origin] & first_copy
        ahead = segments[0] + segments[3] > 0
        starts_part = starts_run.copy()
        starts_part[1:] |= ahead[1:] != ahead[:-1]
        rows = _long_parts(segments, starts_part, run, min_length)
        segments, source, run, starts_part = segments[:, rows], source[rows], run[rows], starts_part[rows]
    return _assemble(segments, source, starts_part, run, run_start, run_end)


def _running_length(xyz: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Cumulative xy arc length over all polylines; the step from one polyline to the next has length 0."""
    total = np.zeros(xyz.shape[1])
    if len(total) > 1:
        step = xyz[:2, 1:] - xyz[:2, :-1]
        step *= step
        length = np.sqrt(step[0] + step[1])
        length[offsets[1:-1] - 1] = 0.0
        length.cumsum(out=total[1:])
    return total


def _group_bounds(starts_group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last row of every group of rows, from a mask of the rows that start one."""
    head = starts_group.nonzero()[0]
    tail = np.empty_like(head)
    if head.size:
        tail[:-1], tail[-1] = head[1:] - 1, len(starts_group) - 1
    return head, tail


def _clip_segments(segments: np.ndarray, window: tuple[float, float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Liang-Barsky clipping: columns clipped to the window, and which of them meet it in more than a point."""
    start, delta = segments[:2], segments[3:5] - segments[:2]
    low, high = np.array([[window[0]], [window[2]]]), np.array([[window[1]], [window[3]]])
    with np.errstate(divide="ignore", invalid="ignore"):
        lower, upper = (low - start) / delta, (high - start) / delta
    # Segments parallel to an axis: outcodes have removed those outside, so this axis sets no bound.
    flat = delta == 0
    near, far = np.minimum(lower, upper), np.maximum(lower, upper)
    near[flat], far[flat] = -np.inf, np.inf
    enter, leave = np.maximum(near.max(0), 0.0), np.minimum(far.min(0), 1.0)
    inside = enter < leave
    rows = np.array([0, 1, 2, 6]), np.array([3, 4, 5, 7])
    begin, end = segments[rows[0]], segments[rows[1]]
    clipped = segments.copy()
    clipped[rows[0]] = np.where(enter > 0, begin + enter * (end - begin), begin)
    clipped[rows[1]] = np.where(leave < 1, begin + leave * (end - begin), end)
    # Rounding may leave the new points slightly outside.
    for ends in (clipped[:2], clipped[3:5]):
        np.minimum(np.maximum(ends, low, out=ends), high, out=ends)
    return clipped, inside


def _split_at_zero(segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns with those that cross x = 0 split in two, and the column that each comes from."""
    crossing = (segments[0] * segments[3] < 0).nonzero()[0]
    copies = np.ones(segments.shape[1], np.int64)
    copies[crossing] = 2
    origin = np.arange(segments.shape[1]).repeat(copies)
    split = segments[:, origin]
    begin, end = segments[:, crossing][[0, 1, 2, 6]], segments[:, crossing][[3, 4, 5, 7]]
    middle = begin + begin[0] / (begin[0] - end[0]) * (end - begin)
    middle[0] = 0.0
    first_half = crossing + np.arange(len(crossing))
    for row, target in enumerate((3, 4, 5, 7)):
        split[target, first_half] = middle[row]
    for row, target in enumerate((0, 1, 2, 6)):
        split[target, first_half + 1] = middle[row]
    return split, origin


def _long_parts(segments: np.ndarray, starts_part: np.ndarray, run: np.ndarray, min_length: float) -> np.ndarray:
    """Columns of parts that are at least ``min_length`` long or the longest of their run."""
    head, tail = _group_bounds(starts_part)
    length = segments[7, tail] - segments[6, head]
    longest = np.zeros(run[-1] + 1)
    np.maximum.at(longest, run[head], length)
    keep = (length >= min_length) | (length == longest[run[head]])
    return keep.repeat(tail - head + 1)


def _assemble(segments, source, starts_part, run, run_start, run_end) -> ClippedPolylines:
    head, tail = _group_bounds(starts_part)
    pieces = len(head)
    end_row = np.arange(len(source)) + starts_part.cumsum()  # of each segment's end in the table of points
    table = np.empty((len(source) + pieces, 4))
    table[end_row] = segments[[3, 4, 5, 7]].T
    table[end_row[head] - 1] = segments[:, head][[0, 1, 2, 6]].T
    offsets = np.empty(pieces + 1, np.int64)
    offsets[:-1], offsets[-1] = end_row[head] - 1, len(table)
    same_run = np.zeros(pieces + 1, bool)  # same_run[k]: pieces k - 1 and k are parts of one run
    run = run[head]
    same_run[1:-1] = run[1:] == run[:-1]
    span = np.empty((pieces, 2))
    span[:, 0], span[:, 1] = segments[6, head], segments[7, tail]
    return ClippedPolylines(
        points=table[:, :3],
        offsets=offsets,
        source=source[head],
        arc=span,
        has_start=run_start[run] & ~same_run[:-1],
        has_end=run_end[run] & ~same_run[1:],
        follows=same_run[:-1],
        point_arc=table[:, 3],
    )


def resample_pieces(pieces: ClippedPolylines, count: int) -> Float64[np.ndarray, "pieces count 3"]:
    """Every piece as ``count`` points equally spaced in xy arc length; z is linear in the same parameter."""
    total = len(pieces.source)
    if not total:
        return np.zeros((0, count, 3))
    points, offsets, span = pieces.points, pieces.offsets, pieces.arc
    length = span[:, 1] - span[:, 0]
    # One increasing axis for all polylines, so that a single search finds all segments.
    shift = (length + 1.0).cumsum() - length - span[:, 0]
    axis = pieces.point_arc + shift.repeat(offsets[1:] - offsets[:-1])
    target = length[:, None] * _fractions(count)
    target += (shift + span[:, 0])[:, None]
    left = axis.searchsorted(target.ravel(), side="right").reshape(total, count) - 1
    left = np.minimum(np.maximum(left, offsets[:-1, None]), offsets[1:, None] - 2)
    width = axis[left + 1] - axis[left]
    ratio = (target - axis[left]) / np.where(width > 0, width, 1.0)
    ratio = np.minimum(np.maximum(ratio, 0.0), 1.0)
    begin = points[left]
    return begin + ratio[..., None] * (points[left + 1] - begin)


@functools.cache
def _fractions(count: int) -> np.ndarray:
    return np.linspace(0.0, 1.0, count)[None]


def simplify_polylines(
    points: Float64[np.ndarray, "points 3"], offsets: Int[np.ndarray, " offsets"], tolerance: float
) -> tuple[Float64[np.ndarray, "kept 3"], Int[np.ndarray, " offsets"]]:
    """Fewer points, such that no point at any arc-length fraction of a chord moves by more than ``tolerance`` [m].

    Douglas-Peucker with the deviation measured at equal arc length, so that resampled points stay in place along the
    lane too. All polylines are split level by level.
    """
    arc = arc_lengths(points, offsets)
    finite = np.nan_to_num(points, nan=0.0)
    keep = np.zeros(len(points), bool)
    low, high = offsets[:-1], offsets[1:] - 1
    keep[low] = keep[high] = True
    while True:
        wide = high - low >= 2
        low, high = low[wide], high[wide]
        if not low.size:
            break
        inner = high - low - 1
        begin = np.concatenate([[0], np.cumsum(inner)[:-1]])
        chord = np.repeat(np.arange(len(low)), inner)
        index = np.arange(inner.sum()) - begin[chord] + low[chord] + 1
        span = arc[high] - arc[low]
        ratio = (arc[index] - arc[low][chord]) / np.where(span > 0, span, 1.0)[chord]
        foot = finite[low][chord] + ratio[:, None] * (finite[high] - finite[low])[chord]
        error = np.sqrt(((finite[index] - foot) ** 2).sum(-1))
        worst = np.maximum.reduceat(error, begin)
        # A zigzag of close points is within the tolerance, but adds up in the length of a lane.
        chords = np.hypot(*(finite[high] - finite[low])[:, :2].T)
        split = (worst > tolerance) | (span - chords > MAX_SHORTENING * span)
        worst_rows = np.flatnonzero(error == worst[chord])
        _, first_rows = np.unique(chord[worst_rows], return_index=True)
        middle = index[worst_rows[first_rows]][split]
        keep[middle] = True
        low, high = np.concatenate([low[split], middle]), np.concatenate([middle, high[split]])
    return points[keep], np.concatenate([[0], np.cumsum(keep)])[offsets]


def order_by_distance(lanes: Float[np.ndarray, "pieces count 3"]) -> Int[np.ndarray, " pieces"]:
    """Permutation that sorts resampled lanes by the distance of their nearest point to the origin (stable)."""
    squared = lanes[..., 0] * lanes[..., 0] + lanes[..., 1] * lanes[..., 1]
    distance = np.sqrt(squared.min(-1)) if len(lanes) else np.zeros(0)
    # Lanes that meet in one point are equally near: rounding noise must not decide.
    return np.argsort(np.round(distance, 9), kind="stable")


def piece_successors(
    pieces: ClippedPolylines, successors: Int[np.ndarray, "edges 2"], count: int
) -> Int[np.ndarray, "piece_edges 2"]:
    """Pairs (i, j) where piece j follows piece i.

    Polylines that follow each other give a pair if the true end of i and the true start of j are both inside; so do
    the two parts at a cut.

    Args:
      successors: (i, j) of the ``count`` polylines the pieces were cut from.
    """
    last, first = np.full(count, -1), np.full(count, -1)
    last[pieces.source[pieces.has_end]] = pieces.has_end.nonzero()[0]
    first[pieces.source[pieces.has_start]] = pieces.has_start.nonzero()[0]
    before, after = last[successors[:, 0]], first[successors[:, 1]]
    inside = (before >= 0) & (after >= 0)
    after_cut = pieces.follows.nonzero()[0]
    return np.array([np.append(before[inside], after_cut - 1), np.append(after[inside], after_cut)]).T
