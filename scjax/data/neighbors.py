"""Left and right neighbors of lanes, as recorded or by geometry; only lanes of the same driving direction."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

from scjax.data.ragged import arc_lengths
from scjax.scene import LaneNeighbor, MapLane

MIN_LATERAL, MAX_LATERAL = 2.5, 5.0  # m between centerlines side by side
MAX_HEADING_DIFFERENCE = np.deg2rad(15.0)
MAX_HEIGHT_DIFFERENCE = 2.0  # m; more is another level
SAMPLE_SPACING = 2.0  # m between the sample points of a lane
MAX_LISTED_DISTANCE = 8.0  # m between lanes that the source calls neighbors, where they are side by side
MIN_OVERLAP_LENGTH = 5.0  # m side by side, or half of the shorter lane
SECOND_ROW = 1.0  # m; a lane this much farther than the nearest on that side is not the next one

Neighbors = tuple[Int[np.ndarray, "pairs 2"], Float64[np.ndarray, "pairs 4"]]


def recorded_neighbors(
    lanes: list[MapLane],
    chains: list[list[int]],
    points: Float64[np.ndarray, "points 3"],
    offsets: Int[np.ndarray, " offsets"],
) -> tuple[np.ndarray, np.ndarray, int]:
    """Neighbors given by the source, carried over to merged lanes.

    Neighbors that are more than 8 m apart where the source says they are side by side are refused.

    Sources that do not say where two lanes are side by side also list lanes that fork. For them only pairs that
    ``infer_neighbors`` finds too are kept, with its spans.

    Args:
      lanes: recorded lanes.
      chains: members of every merged lane, as indices into ``lanes``.
      points, offsets: the merged lanes.

    Returns:
      ``LaneGraph.neighbors`` (left, right) of merged lanes, ``LaneGraph.overlap_spans`` [m], and how many were
      refused.
    """
    index = {lane.id: i for i, lane in enumerate(lanes)}
    arcs = [arc_lengths(lane.points, np.array([0, len(lane.points)])) for lane in lanes]
    chain_of, shift = np.zeros(len(lanes), int), np.zeros(len(lanes))
    for row, chain in enumerate(chains):
        chain_of[chain] = row
        shift[chain] = np.concatenate([[0.0], np.cumsum([arcs[i][-1] for i in chain])[:-1]])
    direction = [lane.points[-1, :2] - lane.points[0, :2] for lane in lanes]
    rows, all_spans_known, refused = [], True, 0
    for i, lane in enumerate(lanes):
        for entries, is_left in ((lane.left_neighbors, True), (lane.right_neighbors, False)):
            for entry in entries:
                j = index.get(entry.lane_id)
                # AV2 lists oncoming neighbors too.
                if j is None or chain_of[i] == chain_of[j] or direction[i] @ direction[j] <= 0:
                    continue
                if _distance_beside(lane, lanes[j], entry) > MAX_LISTED_DISTANCE:
                    refused += 1
                    continue
                all_spans_known &= None not in entry
                own = _arc_span(arcs[i], entry.self_start_index, entry.self_end_index) + shift[i]
                other = _arc_span(arcs[j], entry.neighbor_start_index, entry.neighbor_end_index) + shift[j]
                left, right = ((j, other), (i, own)) if is_left else ((i, own), (j, other))
                rows.append((chain_of[left[0]], chain_of[right[0]], *left[1], *right[1]))
    table = np.array(rows, np.float64).reshape(-1, 6)
    pairs, spans = _merge_rows(table[:, :2].astype(int), table[:, 2:])
    if all_spans_known:
        return *_drop_short_overlaps(pairs, spans, points, offsets), refused
    inferred_pairs, inferred_spans = infer_neighbors(points, offsets)
    recorded = set(map(tuple, pairs))
    keep = np.array([tuple(pair) in recorded for pair in inferred_pairs], bool)
    return inferred_pairs[keep], inferred_spans[keep], refused


def _distance_beside(lane: MapLane, neighbor: MapLane, entry: LaneNeighbor) -> float:
    """Distance [m] to the neighbor's nearest point, from the middle of the span or, without one, from any point."""
    points = lane.points[:, :2]
    if entry.self_start_index is not None and entry.self_end_index is not None:
        middle = np.clip((entry.self_start_index + entry.self_end_index) // 2, 0, len(points) - 1)
        points = points[middle : middle + 1]
    return float(np.hypot(*(neighbor.points[:, None, :2] - points[None]).T).min())


def _arc_span(arc: np.ndarray, start: int | None, end: int | None) -> np.ndarray:
    """Arc lengths [m] at two point indices; those of the whole lane where the source has none."""
    if start is None or end is None:
        return arc[[0, -1]]
    return arc[np.clip(sorted((start, end)), 0, len(arc) - 1)]


def infer_neighbors(points: Float64[np.ndarray, "points 3"], offsets: Int[np.ndarray, " offsets"]) -> Neighbors:
    """Lanes that run side by side the same way, 2.5 to 5 m apart, over at least 5 m (or half of the shorter one).

    Returns:
      as ``recorded_neighbors``.
    """
    from scipy.spatial import KDTree

    lane, sample_arc, cell, position, tangent = _sample_lanes(points, offsets)
    pairs = KDTree(position[:, :2]).query_pairs(np.hypot(MAX_LATERAL, SAMPLE_SPACING), output_type="ndarray")
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    pairs = pairs[lane[pairs[:, 0]] != lane[pairs[:, 1]]]
    cosine = (tangent[pairs[:, 0]] * tangent[pairs[:, 1]]).sum(-1)
    pairs = pairs[cosine > np.cos(MAX_HEADING_DIFFERENCE)]
    a, b = pairs.T
    offset = position[b] - position[a]
    forward = (offset[:, :2] * tangent[a]).sum(-1)
    lateral = tangent[a, 0] * offset[:, 1] - tangent[a, 1] * offset[:, 0]
    adjacent = (np.abs(forward) <= 0.5 * cell[lane[b]] + 0.1) & (np.abs(lateral) >= MIN_LATERAL)
    adjacent &= (np.abs(lateral) <= MAX_LATERAL) & ~(np.abs(offset[:, 2]) > MAX_HEIGHT_DIFFERENCE)
    a, b, lateral = a[adjacent], b[adjacent], lateral[adjacent]
    side_of_sample = 2 * a + (lateral > 0)
    nearest = np.full(2 * len(lane), np.inf)
    np.minimum.at(nearest, side_of_sample, np.abs(lateral))
    first_row = np.abs(lateral) <= nearest[side_of_sample] + SECOND_ROW
    a, b, on_left = a[first_row], b[first_row], lateral[first_row] > 0

    left, right = np.where(on_left, b, a), np.where(on_left, a, b)
    left_half, right_half = cell[lane[left]] / 2, cell[lane[right]] / 2
    left_arc, right_arc = sample_arc[left], sample_arc[right]
    spans = np.stack([left_arc - left_half, left_arc + left_half, right_arc - right_half, right_arc + right_half], -1)
    return _drop_short_overlaps(*_merge_rows(np.stack([lane[left], lane[right]], -1), spans), points, offsets)


def _sample_lanes(
    points: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Samples in the middle of equal cells of at most ``SAMPLE_SPACING`` along every lane.

    Returns:
      lane and arc length [m] of each sample, cell length of each lane [m], position [m] and tangent of each sample.
    """
    arc = arc_lengths(points, offsets)
    length = arc[offsets[1:] - 1]
    count = np.maximum(np.ceil(length / SAMPLE_SPACING).astype(int), 1)
    lane = np.repeat(np.arange(len(length)), count)
    cell = length / count
    sample_arc = (np.arange(len(lane)) - np.repeat(np.cumsum(count) - count, count) + 0.5) * cell[lane]
    # One increasing axis for all lanes, so that a single search finds all segments.
    base = np.concatenate([[0.0], np.cumsum(length + 1.0)[:-1]])
    start = np.searchsorted(arc + np.repeat(base, np.diff(offsets)), sample_arc + base[lane], side="right") - 1
    start = np.clip(start, offsets[lane], offsets[lane + 1] - 2)
    delta = points[start + 1] - points[start]
    width = arc[start + 1] - arc[start]
    position = points[start] + ((sample_arc - arc[start]) / width)[:, None] * delta
    return lane, sample_arc, cell, position, delta[:, :2] / width[:, None]


def _drop_short_overlaps(pairs: np.ndarray, spans: np.ndarray, points: np.ndarray, offsets: np.ndarray) -> Neighbors:
    length = arc_lengths(points, offsets)[offsets[1:] - 1]
    overlap = np.minimum(spans[:, 1] - spans[:, 0], spans[:, 3] - spans[:, 2])
    enough = overlap >= np.minimum(MIN_OVERLAP_LENGTH, 0.5 * np.minimum(length[pairs[:, 0]], length[pairs[:, 1]]))
    return pairs[enough], spans[enough]


def _merge_rows(pairs: np.ndarray, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One row per pair of lanes, from the first to the last place where they are side by side.

    Where each of two lanes is recorded on the left of the other, the longer overlap wins.
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
