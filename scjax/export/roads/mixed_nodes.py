"""Places where several lanes end and several begin: merges and forks with a short lane between them.

A junction there would hold a way for each pair of lanes. All these ways cross in one point, and simulators that draw
their own ways through a junction warn about turns that cross.
"""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
from jaxtyping import Float64

from scjax.export.base import Losses
from scjax.export.roads.lane_network import LaneNetwork
from scjax.export.roads.lane_nodes import LaneNode, NodeKind, lane_nodes, meeting_lines
from scjax.scene import MapLane
from scjax.scene.polyline import cumulative_length

SHORT_LENGTH = 1.0
"""Of the lane between a merge and a fork [m]."""

_MOST_SHARE = 0.2  # of the shortest lane that ends or begins there


def split_mixed_nodes(network: LaneNetwork, losses: Losses) -> LaneNetwork:
    """The network without places where several lanes end and several begin.

    Where each lane leads to each, they merge into one short lane that forks. Elsewhere each lane that leads to several
    forks, and a short lane leads to one at which several arrive. A lane that follows itself gets a short lane between.
    """
    for node in lane_nodes(network, Losses()):
        if node.kind is NodeKind.MIXED:
            network = _split(network, node)
            losses["places where several lanes meet several, written as merges and forks"] += 1
    return network


def _split(network: LaneNetwork, node: LaneNode) -> LaneNetwork:
    lines, _ = meeting_lines(network, [node])
    lengths = [cumulative_length(lines[row])[-1] for row in (*node.before, *node.after)]
    half = min(SHORT_LENGTH, _MOST_SHARE * min(lengths)) / 2
    first = np.mean([_place(lines[i][::-1], half) for i in node.before], axis=0)
    last = np.mean([_place(lines[j], half) for j in node.after], axis=0)
    lanes, successors = list(network.lanes), [list(some) for some in network.successors]
    is_full = len(node.pairs) == len(node.before) * len(node.after)
    if is_full and len({lanes[row].lane_type for row in (*node.before, *node.after)}) == 1:
        short = {(node.before, node.after)}
    else:
        follows, leads = (Counter(pair[k] for pair in node.pairs) for k in (0, 1))
        short = {((i,), (j,)) for i, j in node.pairs if i == j or (follows[i] > 1 and leads[j] > 1)}
    forks, merges = ({row for pair in short for row in pair[k]} for k in (0, 1))
    for i in node.before:
        lines[i] = _with_first(lines[i][::-1], half, first if i in forks else last)[::-1]
    for j in node.after:
        lines[j] = _with_first(lines[j], half, last if j in merges else first)
    for before, after in sorted(short):
        name = "+".join(lanes[i].id for i in before) + ">" + "+".join(lanes[j].id for j in after)
        for i in before:
            successors[i] = [*(j for j in successors[i] if j not in after), len(lanes)]
        lanes.append(MapLane(name, lanes[after[0]].lane_type, np.stack([first, last])))
        lines.append(lanes[-1].points)
        successors.append(list(after))
    predecessors = [[i for i, some in enumerate(successors) if j in some] for j in range(len(lanes))]
    blank = ((),) * (len(lanes) - len(network.lanes))
    return dataclasses.replace(
        network,
        lanes=tuple(lanes),
        lines=tuple(lines),
        successors=tuple(map(tuple, successors)),
        predecessors=tuple(map(tuple, predecessors)),
        left=network.left + blank,
        right=network.right + blank,
    )


def _place(line: Float64[np.ndarray, "n 3"], arc: float) -> Float64[np.ndarray, " xyz"]:
    """The point at an arc length [m]."""
    arcs = cumulative_length(line)
    return np.array([np.interp(arc, arcs, column) for column in line.T])


def _with_first(
    line: Float64[np.ndarray, "n 3"], cut: float, first: Float64[np.ndarray, " xyz"]
) -> Float64[np.ndarray, "m 3"]:
    """A line that begins at another point; what lies less than ``2 cut`` from its old start is left out [m]."""
    return np.concatenate([first[None], line[cumulative_length(line) > 2 * cut]])
