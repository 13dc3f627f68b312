"""Left and right neighbours of lanes: as recorded, or found by geometry. Same driving direction only."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float64, Int
from scipy.spatial import KDTree

from scjax.data.ragged import arc_lengths
from scjax.data.readers.scene_json import RawLane

MIN_LATERAL, MAX_LATERAL = 2.5, 5.0  # metres between centrelines side by side
MAX_HEADING = np.deg2rad(15.0)
MAX_CLIMB = 2.0  # metres of height between neighbours; more is another level
SPACING = 2.0  # metres between the sample points of a lane
MIN_OVERLAP = 5.0  # metres side by side, or half of the shorter lane
BEHIND = 1.0  # metres; a lane this much farther than the nearest on that side is not the next one


def recorded(
    lanes: list[RawLane], chains: list[list[int]], points: Float64[np.ndarray, "points 3"],
    offsets: Int[np.ndarray, " offsets"],
) -> tuple[Int[np.ndarray, "pairs 2"], Float64[np.ndarray, "pairs 4"]]:  # fmt: skip
    """Neighbours given by the source, carried over to merged lanes.

    Sources that do not say where two lanes are side by side also list lanes that fork: there only pairs that
    ``by_geometry`` finds too are kept, and its spans are taken.

    Args:
      lanes: the kept source lanes.
      chains: members of every merged lane; points, offsets: the merged lanes.

    Returns:
      pairs (left lane, right lane) of merged lanes and their spans, as in ``LaneGraph.beside`` and ``spans``.
    """
    index = {lane.id: i for i, lane in enumerate(lanes)}
    arcs = [arc_lengths(lane.points, np.array([0, len(lane.points)])) for lane in lanes]
    chain_of, shift = np.zeros(len(lanes), int), np.zeros(len(lanes))
    for row, chain in enumerate(chains):
        chain_of[chain] = row
        shift[chain] = np.concatenate([[0.0], np.cumsum([arcs[i][-1] for i in chain])[:-1]])
    direction = [lane.points[-1, :2] - lane.points[0, :2] for lane in lanes]
    rows, ranged = [], True
    for i, lane in enumerate(lanes):
        for entries, is_left in ((lane.left, True), (lane.right, False)):
            for name, *span in entries:
                j = index.get(name)
                # AV2 lists oncoming neighbours too.
                if j is None or chain_of[i] == chain_of[j] or direction[i] @ direction[j] <= 0:
                    continue
                ranged &= len(span) == 4 and None not in span
                own, other = _stretch(arcs[i], span[:2]) + shift[i], _stretch(arcs[j], span[2:]) + shift[j]
                pair = (j, i, *other, *own) if is_left else (i, j, *own, *other)
                rows.append((chain_of[pair[0]], chain_of[pair[1]], *pair[2:]))
    table = np.array(rows, np.float64).reshape(-1, 6)
    pairs, spans = _merge(table[:, :2].astype(int), table[:, 2:])
    if ranged:
        return _long_enough(pairs, spans, points, offsets)
    found, found_spans = by_geometry(points, offsets)
    named = set(map(tuple, pairs))
    keep = np.array([tuple(pair) in named for pair in found], bool)
    return found[keep], found_spans[keep]


def _stretch(arc: np.ndarray, span: list[Any]) -> np.ndarray:
    if len(span) < 2 or span[0] is None or span[1] is None:
        return arc[[0, -1]]
    return arc[np.clip(sorted(span), 0, len(arc) - 1)]


def by_geometry(
    points: Float64[np.ndarray, "points 3"], offsets: Int[np.ndarray, " offsets"]
) -> tuple[Int[np.ndarray, "pairs 2"], Float64[np.ndarray, "pairs 4"]]:
    """Lanes that run side by side the same way, 2.5 to 5 m apart, over at least 5 m (or half of the shorter one).

    Returns:
      as ``recorded``.
    """
    arc = arc_lengths(points, offsets)
    length = arc[offsets[1:] - 1]
    count = np.maximum(np.ceil(length / SPACING).astype(int), 1)
    lane = np.repeat(np.arange(len(length)), count)
    cell = length / count
    at = (np.arange(len(lane)) - np.repeat(np.cumsum(count) - count, count) + 0.5) * cell[lane]
    base = np.concatenate([[0.0], np.cumsum(length + 1.0)[:-1]])
    left = np.searchsorted(arc + np.repeat(base, np.diff(offsets)), at + base[lane], side="right") - 1
    left = np.clip(left, offsets[lane], offsets[lane + 1] - 2)
    delta = points[left + 1] - points[left]
    width = arc[left + 1] - arc[left]
    place = points[left] + ((at - arc[left]) / width)[:, None] * delta
    ahead = delta[:, :2] / width[:, None]

    pairs = KDTree(place[:, :2]).query_pairs(np.hypot(MAX_LATERAL, SPACING), output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    pairs = pairs[lane[pairs[:, 0]] != lane[pairs[:, 1]]]
    pairs = pairs[(ahead[pairs[:, 0]] * ahead[pairs[:, 1]]).sum(-1) > np.cos(MAX_HEADING)]
    a, b = pairs.T
    to = place[b] - place[a]
    forward = (to[:, :2] * ahead[a]).sum(-1)
    lateral = ahead[a, 0] * to[:, 1] - ahead[a, 1] * to[:, 0]
    good = (np.abs(forward) <= 0.5 * cell[lane[b]] + 0.1) & (np.abs(lateral) >= MIN_LATERAL)
    good &= (np.abs(lateral) <= MAX_LATERAL) & ~(np.abs(to[:, 2]) > MAX_CLIMB)
    a, b, lateral = a[good], b[good], lateral[good]
    slot = 2 * a + (lateral > 0)
    nearest = np.full(2 * len(lane), np.inf)
    np.minimum.at(nearest, slot, np.abs(lateral))
    good = np.abs(lateral) <= nearest[slot] + BEHIND
    a, b, on_left = a[good], b[good], lateral[good] > 0

    # b is to the left of a, or a to the left of b: the left one first.
    high, low = np.where(on_left, b, a), np.where(on_left, a, b)
    edge_high, edge_low = cell[lane[high]] / 2, cell[lane[low]] / 2
    spans = np.stack([at[high] - edge_high, at[high] + edge_high, at[low] - edge_low, at[low] + edge_low], -1)
    return _long_enough(*_merge(np.stack([lane[high], lane[low]], -1), spans), points, offsets)


def _long_enough(pairs, spans, points, offsets):
    length = arc_lengths(points, offsets)[offsets[1:] - 1]
    overlap = np.minimum(spans[:, 1] - spans[:, 0], spans[:, 3] - spans[:, 2])
    enough = overlap >= np.minimum(MIN_OVERLAP, 0.5 * np.minimum(length[pairs[:, 0]], length[pairs[:, 1]]))
    return pairs[enough], spans[enough]


def _merge(pairs: np.ndarray, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One row a pair of lanes, from the first to the last place where they are side by side.

    Where both are said to be on the left of the other, the longer overlap wins.
    """
    if not len(pairs):
        return np.zeros((0, 2), np.int64), np.zeros((0, 4))
    unique, row = np.unique(pairs, axis=0, return_inverse=True)
    row = row.reshape(-1)
    hull = np.tile([np.inf, -np.inf, np.inf, -np.inf], (len(unique), 1))
    for column, reduce in enumerate((np.minimum, np.maximum, np.minimum, np.maximum)):
        reduce.at(hull[:, column], row, spans[:, column])
    length = dict(zip(map(tuple, unique), hull[:, 1] - hull[:, 0], strict=True))
    keep = np.array([length.get((j, i), -1.0) < length[i, j] or ((j, i) not in length) for i, j in unique])
    return unique[keep].astype(np.int64), hull[keep]
