"""Everything around one pose of a log: lanes and agents in the pose's frame, to be cropped to scenes."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int, Integer

from scjax.data import ragged
from scjax.data.agents import clean_agents
from scjax.data.lane_graph import LaneGraph, SegmentIndex
from scjax.data.tiles import Pose, agents_at, to_pose_frame
from scjax.scene import Log

RADIUS = 80.0  # m; the far corners of the forward window are 71.6 m away
MIN_OVERLAP = 2.0  # m that two pieces must share to be neighbors, or half of the shorter piece
SIMPLIFY_TOLERANCE = 1e-4  # m; crops cost by the point, and nobody sees 0.2 mm


@dataclasses.dataclass(frozen=True)
class LocalMap:
    """Everything around one pose, in its frame (x forward, y left, z above the ground under the ego).

    Attributes:
      points, offsets: centerlines as ragged polylines in driving direction [m]; z is 0 where unknown.
      lane_z_known: whether z of the lane was recorded.
      successors, neighbors, overlap_spans: as in ``LaneGraph``.
      signals: ``Signal`` of each lane at the step of the pose.
      agents: nine columns of ``Scene.agents``; the ego first, then by distance. Unknown values are filled.
      agent_types: ``AgentType``.
      agent_known: False where a value was filled.
      off_road: vehicles more than 2.5 m from every centerline.
    """

    points: Float[np.ndarray, "points 3"]
    offsets: Int[np.ndarray, " offsets"]
    lane_z_known: Bool[np.ndarray, " lanes"]
    successors: Int[np.ndarray, "edges 2"]
    neighbors: Int[np.ndarray, "pairs 2"]
    overlap_spans: Float[np.ndarray, "pairs 4"]
    signals: Integer[np.ndarray, " lanes"]
    agents: Float[np.ndarray, "agents 9"]
    agent_types: Integer[np.ndarray, " agents"]
    agent_known: Bool[np.ndarray, "agents 9"]
    off_road: Bool[np.ndarray, " agents"]


def simplify_graph(graph: LaneGraph) -> LaneGraph:
    """``graph`` with fewer points, none of which moves by more than 0.1 mm: what ``cut_local_map`` wants.

    Spans keep their meaning: arc lengths change by far less than their resolution.
    """
    points, offsets = ragged.simplify_polylines(graph.points, graph.offsets, SIMPLIFY_TOLERANCE)
    return dataclasses.replace(graph, points=points, offsets=offsets)


def cut_local_map(log: Log, graph: LaneGraph, index: SegmentIndex, pose: Pose) -> tuple[LocalMap, dict[str, int]]:
    """Everything within 80 m of ``pose``, and the counts of cleaned agent values (``clean_agents``).

    Lanes are clipped to the square of half edge ``RADIUS``, agents to the circle.

    Args:
      graph: simplified lanes of ``log`` (``simplify_graph``).
      index: search structure of the lanes before they were simplified.
    """
    window = (-RADIUS, RADIUS, -RADIUS, RADIUS)
    pieces = ragged.clip_polylines(to_pose_frame(graph.points, pose), graph.offsets, window)
    neighbors, spans = neighbor_pieces(pieces, graph.neighbors, graph.overlap_spans, graph.num_lanes, overlap=0.0)
    agents = agents_at(log, index, pose, RADIUS)
    states, known, counts = clean_agents(agents.states, agents.types)
    local_map = LocalMap(
        points=np.nan_to_num(pieces.points, nan=0.0).astype(np.float32),
        offsets=pieces.offsets.astype(np.int32),
        lane_z_known=~np.isnan(pieces.points[pieces.offsets[:-1], 2]),
        successors=ragged.piece_successors(pieces, graph.successors, graph.num_lanes).astype(np.int16),
        neighbors=neighbors.astype(np.int16),
        overlap_spans=spans.astype(np.float32),
        signals=graph.signals[pieces.source, pose.step].astype(np.uint8),
        agents=states.astype(np.float32),
        agent_types=agents.types.astype(np.uint8),
        agent_known=known,
        off_road=agents.off_road,
    )
    return local_map, counts


def neighbor_pieces(
    pieces: ragged.ClippedPolylines,
    neighbors: Int[np.ndarray, "pairs 2"],
    overlap_spans: Float[np.ndarray, "pairs 4"],
    count: int,
    overlap: float = MIN_OVERLAP,
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (left, right) of pieces that are side by side [pairs, 2], and their spans on the pieces [pairs, 4] in m.

    Args:
      neighbors, overlap_spans: those of the ``count`` polylines that the pieces were cut from.
      overlap: length that two pieces must share [m], or half of the shorter one.
    """
    pair_of = np.full((count, count), -1, np.int16)
    pair_of[neighbors[:, 0], neighbors[:, 1]] = np.arange(len(neighbors))
    piece_pairs = pair_of[pieces.source[:, None], pieces.source[None, :]]
    left, right = np.nonzero(piece_pairs >= 0)
    if not left.size:
        return np.zeros((0, 2), np.int64), np.zeros((0, 4))
    span = overlap_spans[piece_pairs[left, right]].astype(np.float64)
    left_span, right_span = span[:, :2], span[:, 2:]
    scale = (right_span[:, 1] - right_span[:, 0]) / np.maximum(left_span[:, 1] - left_span[:, 0], 1e-6)
    left_arc, right_arc = pieces.arc[left], pieces.arc[right]
    # The extent of the right piece, carried over to the left lane.
    carried = left_span[:, :1] + (right_arc - right_span[:, :1]) / np.maximum(scale, 1e-6)[:, None]
    low = np.maximum(np.maximum(left_span[:, 0], left_arc[:, 0]), carried[:, 0])
    high = np.minimum(np.minimum(left_span[:, 1], left_arc[:, 1]), carried[:, 1])
    length = np.minimum(left_arc[:, 1] - left_arc[:, 0], right_arc[:, 1] - right_arc[:, 0])
    enough = high - low >= np.minimum(overlap, 0.5 * length)
    enough &= high > low
    on_left = np.stack([low, high], -1)
    on_right = right_span[:, :1] + (on_left - left_span[:, :1]) * scale[:, None]
    shared = np.concatenate([on_left - left_arc[:, :1], on_right - right_arc[:, :1]], -1)
    return np.stack([left, right], -1)[enough], shared[enough]
