"""How good a map of tiles is: dead ends, connected share, joints at seams."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scjax.outpainting.coverage import Coverage
from scjax.scene import Map, TileStatus, measure_seam
from scjax.scene.boxes import overlaps
from scjax.scene.polyline import cumulative_length


class MapMeasures(NamedTuple):
    """Measures of one map.

    Attributes:
      length: of all lanes [m].
      dead_ends: ends of lanes on covered ground to which nothing is connected.
      largest_share: share of the length that is in the largest component; lanes that follow each other or lie beside
        each other are connected.
      gaps, turns: of the connections at seams [m, rad].
      complete, tiles: generated tiles that are complete, and all generated ones, missing ones included.
      attempts: candidates that were generated.
      overlapping: vehicles and other agents whose boxes share ground with another one.
    """

    length: float
    dead_ends: int
    largest_share: float
    gaps: Float64[np.ndarray, " connections"]
    turns: Float64[np.ndarray, " connections"]
    complete: int
    tiles: int
    attempts: int
    overlapping: int


def measure_map(map: Map) -> MapMeasures:
    """Measures of a map with at least one lane."""
    row_of = {lane.id: row for row, lane in enumerate(map.lanes)}
    lengths = np.array([cumulative_length(lane.points)[-1] for lane in map.lanes])
    pairs = [
        (row_of[lane.id], row_of[other])
        for lane in map.lanes
        for other in (*lane.successors, *(n.lane_id for n in (*lane.left_neighbors, *lane.right_neighbors)))
        if other in row_of
    ]
    rows, columns = np.array(pairs, int).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(lengths),) * 2)
    _, component = connected_components(graph, directed=False)
    joints = [measure_seam(map, seam) for seam in map.seams]
    generated = [tile for tile in map.tiles if tile.status != TileStatus.KNOWN]
    boxes = map.agents[~np.isnan(map.agents[:, 6:8]).any(-1)]
    return MapMeasures(
        length=float(lengths.sum()),
        dead_ends=sum(not end.at_border for end in Coverage(map).open_ends(map)),
        largest_share=float(np.bincount(component, lengths).max() / max(lengths.sum(), 1e-9)),
        gaps=np.concatenate([np.zeros(0), *(joint.gaps for joint in joints)]),
        turns=np.concatenate([np.zeros(0), *(joint.turns for joint in joints)]),
        complete=sum(tile.status == TileStatus.COMPLETE for tile in generated),
        tiles=len(generated),
        attempts=sum(tile.attempts for tile in generated),
        overlapping=int(np.any(overlaps(boxes), axis=-1, keepdims=True).sum()) if len(boxes) else 0,
    )
