"""Lanes cut in halves until few points can show their bends: scenes give every lane the same number of points.

Towns need it, since a lane of an OpenDRIVE road may hold bends. In the synthetic worlds a bend is a lane of its own, so
it is enough that ``lane_graph`` does not merge it with long lanes. Halving instead gives 16 of 40 worlds another graph.
"""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from scjax.data import ragged
from scjax.data.lane_graph import LaneGraph
from scjax.data.local_map import neighbor_pieces
from scjax.scene import POINTS_PER_LANE
from scjax.scene.polyline import cumulative_length

MAX_POINT_TURN = float(np.deg2rad(20.0))  # of a lane at one of its points, wherever a window cuts it
_LEAST_LENGTH = 10.0  # m; shorter lanes are not cut, since their points are half a meter apart
_OVERSAMPLING = 4  # places between two points of a lane


def split_bends(graph: LaneGraph) -> LaneGraph:
    """``graph`` with lanes cut until none turns by more than 20 degrees at one of the 20 points of a scene.

    Lanes shorter than 10 m stay whole.
    """
    lines = np.split(graph.points, graph.offsets[1:-1])
    arcs = [cumulative_length(line[:, :2]) for line in lines]
    cuts = [_cut_places(line, arc) for line, arc in zip(lines, arcs, strict=True)]
    if all(len(cut) == 2 for cut in cuts):
        return graph
    pieces = _cut(lines, arcs, cuts)
    neighbors, spans = neighbor_pieces(pieces, graph.neighbors, graph.overlap_spans, graph.num_lanes)
    return dataclasses.replace(
        graph,
        points=pieces.points,
        offsets=pieces.offsets,
        successors=ragged.piece_successors(pieces, graph.successors, graph.num_lanes),
        neighbors=neighbors,
        overlap_spans=spans,
        signals=graph.signals[pieces.source],
    )


def _cut_places(line: Float64[np.ndarray, "points 3"], arc: Float64[np.ndarray, " points"]) -> np.ndarray:
    """Arc lengths at which the pieces of a lane begin and end [m], increasing."""
    places, waiting = [0.0], [(0.0, float(arc[-1]))]
    while waiting:
        low, high = waiting.pop()
        if high - low > _LEAST_LENGTH and _most_turn(line, arc, low, high) > MAX_POINT_TURN:
            middle = (low + high) / 2
            waiting += [(middle, high), (low, middle)]
        else:
            places.append(high)
    return np.array(places)


def _most_turn(line: np.ndarray, arc: np.ndarray, low: float, high: float) -> float:
    """The greatest turn at a point of a piece [rad], for any place of its points."""
    count = _OVERSAMPLING * (POINTS_PER_LANE - 1) + 1
    places = np.linspace(low, high, count)
    xy = np.stack([np.interp(places, arc, column) for column in line[:, :2].T], -1)
    step = xy[_OVERSAMPLING:] - xy[:-_OVERSAMPLING]
    heading = np.arctan2(step[:, 1], step[:, 0])
    turn = heading[_OVERSAMPLING:] - heading[:-_OVERSAMPLING]
    return float(np.abs((turn + np.pi) % (2 * np.pi) - np.pi).max())


def _cut(lines: list[np.ndarray], arcs: list[np.ndarray], cuts: list[np.ndarray]) -> ragged.ClippedPolylines:
    """The pieces of all lanes between their ``cuts``."""
    points, places = [], []
    for line, arc, cut in zip(lines, arcs, cuts, strict=True):
        for low, high in pairwise(cut):
            inner = arc[(arc > low) & (arc < high)]
            at = np.concatenate([[low], inner, [high]])
            points.append(np.stack([np.interp(at, arc, column) for column in line.T], -1))
            places.append(at)
    counts = np.array([len(cut) - 1 for cut in cuts])
    first = np.concatenate([np.arange(count) == 0 for count in counts])
    last = np.concatenate([np.arange(count) == count - 1 for count in counts])
    return ragged.ClippedPolylines(
        points=np.concatenate(points),
        offsets=np.concatenate([[0], np.cumsum([len(piece) for piece in points])]),
        source=np.repeat(np.arange(len(lines)), counts),
        arc=np.stack([[at[0], at[-1]] for at in places]),
        has_start=first,
        has_end=last,
        follows=~first,
        point_arc=np.concatenate(places),
    )
