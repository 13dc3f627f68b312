"""Ragged polylines: polyline i is ``points[offsets[i]:offsets[i + 1]]``. Every function works on all of them at once.

The cost of a training sample is the cost of these functions, hence no Python loop over lanes anywhere.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

MAX_SHORTENING = 5e-6  # of a lane's length by simplification
MIN_PIECE = 0.5  # metres; shorter pieces of a lane say nothing (eval rule, step 5)


@dataclasses.dataclass(frozen=True)
class ClippedPolylines:
    """Parts of polylines inside a window, in the order of the polylines and along each.

    Attributes:
      points, offsets: the pieces as ragged polylines.
      source: index of the polyline each piece was cut from.
      arc: where on that polyline the piece starts and ends, in xy arc length [m].
      has_start, has_end: whether the piece holds the polyline's own first / last point.
      follows: whether the piece continues the one before it without a gap (only after a cut at x = 0).
      point_arc: where on its polyline each point lies, as ``arc``.
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
    """xy arc length from the start of its own polyline to each point, [points], float64, metres."""
    total = _running_length(np.array(points.T, np.float64), offsets)
    return total - np.repeat(total[offsets[:-1]], np.diff(offsets))


def clip_polylines(
    points: Float[np.ndarray, "points 3"],
    offsets: Int[np.ndarray, " offsets"],
    window: tuple[float, float, float, float],
    *,
    cut: bool = False,
    min_length: float = MIN_PIECE,
) -> ClippedPolylines:
    """Exact clipping of every segment to the closed window (x_min, x_max, y_min, y_max).

    A polyline that leaves and returns gives several pieces; a piece shorter than ``min_length`` is dropped unless it is
    a whole polyline. With ``cut`` every piece is cut again where it crosses x = 0; a part shorter than ``min_length``
    is then dropped too (never the longest of its piece), its neighbour takes its place in the chain.
    """
    xyz = np.array(points.T, np.float64, order="C")
    arc = _running_length(xyz, offsets)
    x, y, _ = xyz
    x_min, x_max, y_min, y_max = window
    code = (x < x_min).view(np.uint8) | ((x > x_max).view(np.uint8) << 1)
    code |= ((y < y_min).view(np.uint8) << 2) | ((y > y_max).view(np.uint8) << 3)
    possible = (code[:-1] & code[1:]) == 0
    possible[offsets[1:-1] - 1] = False  # from one polyline to the next is no segment
    first = possible.nonzero()[0]
    source = offsets.searchsorted(first, side="right") - 1
    starts_inside, ends_inside = code[first] == 0, code[first + 1] == 0
    # One column a segment: start xyz, end xyz, arc at the start, arc at the end.
    segments = np.empty((8, len(first)))
    segments[:3], segments[3:6] = xyz[:, first], xyz[:, first + 1]
    base = arc[offsets[source]]
    segments[6], segments[7] = arc[first] - base, arc[first + 1] - base
    crossing = (~(starts_inside & ends_inside)).nonzero()[0]
    if crossing.size:
        shortened, hit = _shorten(segments[:, crossing], window)
        segments[:, crossing] = shortened
        if not hit.all():
            rows = np.ones(len(first), bool)
            rows[crossing] = hit
            segments, first, source = segments[:, rows], first[rows], source[rows]
            starts_inside, ends_inside = starts_inside[rows], ends_inside[rows]
    at_start = (first == offsets[source]) & starts_inside
    at_end = (first + 2 == offsets[source + 1]) & ends_inside
    fresh = np.ones(len(first), bool)  # segments that begin a run, i.e. a piece before any cut at x = 0
    fresh[1:] = ~ends_inside[:-1] | ~starts_inside[1:] | (first[1:] != first[:-1] + 1)

    head, tail = _extent(fresh)
    keep = (segments[7, tail] - segments[6, head] >= min_length) | (at_start[head] & at_end[tail])
    if not keep.all():
        rows = keep.repeat(tail - head + 1)
        segments, source, fresh = segments[:, rows], source[rows], fresh[rows]
        head, tail = head[keep], tail[keep]
    run_start, run_end = at_start[head], at_end[tail]
    part, run = fresh, fresh.cumsum() - 1
    if cut and len(source):
        segments, origin = _split_at_zero(segments)
        first_copy = np.ones(len(origin), bool)
        first_copy[1:] = origin[1:] != origin[:-1]
        source, run, fresh = source[origin], run[origin], fresh[origin] & first_copy
        ahead = segments[0] + segments[3] > 0
        part = fresh.copy()
        part[1:] |= ahead[1:] != ahead[:-1]
        rows = _long_parts(segments, part, run, min_length)
        segments, source, run, part = segments[:, rows], source[rows], run[rows], part[rows]
    return _assemble(segments, source, part, run, run_start, run_end)


def _running_length(xyz: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """xy arc length over all polylines one after another (no length from one to the next)."""
    total = np.zeros(xyz.shape[1])
    if len(total) > 1:
        step = xyz[:2, 1:] - xyz[:2, :-1]
        step *= step
        length = np.sqrt(step[0] + step[1])
        length[offsets[1:-1] - 1] = 0.0
        length.cumsum(out=total[1:])
    return total


def _extent(begins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last row of every group of rows, given which rows begin one."""
    head = begins.nonzero()[0]
    tail = np.empty_like(head)
    if head.size:
        tail[:-1], tail[-1] = head[1:] - 1, len(begins) - 1
    return head, tail


def _shorten(segments: np.ndarray, window: tuple[float, float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Liang-Barsky: columns cut to the window, and which of them meet it in more than a point."""
    start, delta = segments[:2], segments[3:5] - segments[:2]
    low, high = np.array([[window[0]], [window[2]]]), np.array([[window[1]], [window[3]]])
    with np.errstate(divide="ignore", invalid="ignore"):
        lower, upper = (low - start) / delta, (high - start) / delta
    # Parallel to an axis: outcodes have removed those outside, so this axis sets no bound.
    flat = delta == 0
    near, far = np.minimum(lower, upper), np.maximum(lower, upper)
    near[flat], far[flat] = -np.inf, np.inf
    enter, leave = np.maximum(near.max(0), 0.0), np.minimum(far.min(0), 1.0)
    hit = enter < leave
    rows = np.array([0, 1, 2, 6]), np.array([3, 4, 5, 7])
    begin, end = segments[rows[0]], segments[rows[1]]
    cut = segments.copy()
    cut[rows[0]] = np.where(enter > 0, begin + enter * (end - begin), begin)
    cut[rows[1]] = np.where(leave < 1, begin + leave * (end - begin), end)
    # Rounding may leave the new points a hair outside.
    for side in (cut[:2], cut[3:5]):
        np.minimum(np.maximum(side, low, out=side), high, out=side)
    return cut, hit


def _split_at_zero(segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Columns that cross x = 0 doubled, one for each side, and the column each comes from."""
    at = (segments[0] * segments[3] < 0).nonzero()[0]
    times = np.ones(segments.shape[1], np.int64)
    times[at] = 2
    origin = np.arange(segments.shape[1]).repeat(times)
    split = segments[:, origin]
    begin, end = segments[:, at][[0, 1, 2, 6]], segments[:, at][[3, 4, 5, 7]]
    middle = begin + begin[0] / (begin[0] - end[0]) * (end - begin)
    middle[0] = 0.0
    former = at + np.arange(len(at))
    for row, target in enumerate((3, 4, 5, 7)):
        split[target, former] = middle[row]
    for row, target in enumerate((0, 1, 2, 6)):
        split[target, former + 1] = middle[row]
    return split, origin


def _long_parts(segments: np.ndarray, part: np.ndarray, run: np.ndarray, min_length: float) -> np.ndarray:
    """Columns of parts that are at least ``min_length`` long or the longest of their run."""
    head, tail = _extent(part)
    length = segments[7, tail] - segments[6, head]
    longest = np.zeros(run[-1] + 1)
    np.maximum.at(longest, run[head], length)
    keep = (length >= min_length) | (length == longest[run[head]])
    return keep.repeat(tail - head + 1)


def _assemble(segments, source, part, run, run_start, run_end) -> ClippedPolylines:
    head, tail = _extent(part)
    pieces = len(head)
    at = np.arange(len(source)) + part.cumsum()  # where the end of each segment goes
    table = np.empty((len(source) + pieces, 4))
    table[at] = segments[[3, 4, 5, 7]].T
    table[at[head] - 1] = segments[:, head][[0, 1, 2, 6]].T
    offsets = np.empty(pieces + 1, np.int64)
    offsets[:-1], offsets[-1] = at[head] - 1, len(table)
    same = np.zeros(pieces + 1, bool)  # same[k]: pieces k - 1 and k are parts of one run
    run = run[head]
    same[1:-1] = run[1:] == run[:-1]
    span = np.empty((pieces, 2))
    span[:, 0], span[:, 1] = segments[6, head], segments[7, tail]
    return ClippedPolylines(
        points=table[:, :3],
        offsets=offsets,
        source=source[head],
        arc=span,
        has_start=run_start[run] & ~same[:-1],
        has_end=run_end[run] & ~same[1:],
        follows=same[:-1],
        point_arc=table[:, 3],
    )


def resample_pieces(pieces: ClippedPolylines, count: int) -> Float64[np.ndarray, "pieces count 3"]:
    """Every piece as ``count`` points equally spaced in xy arc length (z linear in the same parameter)."""
    total = len(pieces.source)
    if not total:
        return np.zeros((0, count, 3))
    points, offsets, span = pieces.points, pieces.offsets, pieces.arc
    length = span[:, 1] - span[:, 0]
    # One increasing axis for all polylines, so that a single search serves them all.
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
    """Fewer points, such that no point at any arc-length fraction of a chord moves by more than ``tolerance`` metres.

    Douglas-Peucker with the deviation taken at equal arc length (so resampled points stay put along the lane too), all
    polylines level by level.
    """
    arc = arc_lengths(points, offsets)
    solid = np.nan_to_num(points, nan=0.0)
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
        foot = solid[low][chord] + ratio[:, None] * (solid[high] - solid[low])[chord]
        error = np.sqrt(((solid[index] - foot) ** 2).sum(-1))
        worst = np.maximum.reduceat(error, begin)
        # Zigzag of closely spaced points is within the tolerance but adds up in the length of a lane.
        chords = np.hypot(*(solid[high] - solid[low])[:, :2].T)
        split = (worst > tolerance) | (span - chords > MAX_SHORTENING * span)
        at = np.flatnonzero(error == worst[chord])
        _, pick = np.unique(chord[at], return_index=True)
        middle = index[at[pick]][split]
        keep[middle] = True
        low, high = np.concatenate([low[split], middle]), np.concatenate([middle, high[split]])
    return points[keep], np.concatenate([[0], np.cumsum(keep)])[offsets]


def order_by_distance(lanes: Float[np.ndarray, "pieces count 3"]) -> Int[np.ndarray, " pieces"]:
    """Order of resampled lanes by the distance of their nearest point to the origin (stable)."""
    squared = lanes[..., 0] * lanes[..., 0] + lanes[..., 1] * lanes[..., 1]
    distance = np.sqrt(squared.min(-1)) if len(lanes) else np.zeros(0)
    # Lanes that meet in one point are equally near: rounding noise must not decide.
    return np.argsort(np.round(distance, 9), kind="stable")


def piece_successors(
    pieces: ClippedPolylines, successors: Int[np.ndarray, "edges 2"], count: int
) -> Int[np.ndarray, "piece_edges 2"]:
    """Which piece follows which: where the true end of i and the true start of j are both there, and along cuts.

    Args:
      successors: (i, j) of the ``count`` polylines the pieces were cut from.
    """
    last, first = np.full(count, -1), np.full(count, -1)
    last[pieces.source[pieces.has_end]] = pieces.has_end.nonzero()[0]
    first[pieces.source[pieces.has_start]] = pieces.has_start.nonzero()[0]
    before, after = last[successors[:, 0]], first[successors[:, 1]]
    both = (before >= 0) & (after >= 0)
    chained = pieces.follows.nonzero()[0]
    return np.array([np.append(before[both], chained - 1), np.append(after[both], chained)]).T
