"""Places where lanes meet: lanes that follow each other get one point and one direction there."""

from __future__ import annotations

import dataclasses
import enum

import numpy as np
from jaxtyping import Float64

from scjax.export.base import Losses
from scjax.export.roads.lane_network import LaneNetwork
from scjax.scene.polyline import cumulative_length, smoothstep

MAX_TURN = float(np.deg2rad(60.0))
"""Greatest turn between a lane and the next [rad]; connections that turn by more are left out."""

_LEAST_REACH, _REACH = 3.0, 20.0  # m along a lane, and for each meter that its end moves
_FINE_STEP = 1.0  # m between points of the part of a lane that moves


class NodeKind(enum.Enum):
    """How lanes meet."""

    PLAIN = "plain"  # one ends, one begins
    FORK = "fork"  # one ends, several begin
    MERGE = "merge"  # several end, one begins
    MIXED = "mixed"  # several end, several begin; or a lane follows itself


@dataclasses.dataclass(frozen=True)
class LaneNode:
    """A place where lanes meet.

    Attributes:
      before, after: lanes that end and begin there.
      pairs: (i, j), lane j follows lane i.
      place: x, y, z [m].
      heading: [rad].
    """

    before: tuple[int, ...]
    after: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    place: Float64[np.ndarray, " xyz"]
    heading: float

    @property
    def kind(self) -> NodeKind:
        """How many lanes end and begin there."""
        if set(self.before) & set(self.after) or min(len(self.before), len(self.after)) > 1:
            return NodeKind.MIXED
        if len(self.after) > 1:
            return NodeKind.FORK
        return NodeKind.MERGE if len(self.before) > 1 else NodeKind.PLAIN


def lane_nodes(network: LaneNetwork, losses: Losses) -> list[LaneNode]:
    """All places where lanes meet."""
    first, last = _end_headings(network)
    pairs = []
    for i, j in network.pairs:
        if abs(np.angle(np.exp(1j * (first[j] - last[i])))) > MAX_TURN:
            losses[f"connections of lanes that turn by more than {np.rad2deg(MAX_TURN):.0f} degrees, left out"] += 1
        else:
            pairs.append((i, j))
    parent = list(range(2 * len(network.lanes)))  # 2 i is the start of lane i, 2 i + 1 its end

    def root(end: int) -> int:
        while parent[end] != end:
            parent[end] = parent[parent[end]]
            end = parent[end]
        return end

    for i, j in pairs:
        parent[root(2 * i + 1)] = root(2 * j)
    groups: dict[int, list[tuple[int, int]]] = {}
    for pair in pairs:
        groups.setdefault(root(2 * pair[1]), []).append(pair)
    return [_node(network, group, first, last) for group in groups.values()]


def _end_headings(network: LaneNetwork) -> tuple[np.ndarray, np.ndarray]:
    """Directions of all lanes at their start and at their end [rad]."""
    steps = [(line[1] - line[0], line[-1] - line[-2]) for line in network.lines]
    return tuple(np.arctan2(*np.array([step[k][:2] for step in steps]).T[::-1]) for k in (0, 1))  # pyright: ignore


def _node(network: LaneNetwork, pairs: list[tuple[int, int]], first: np.ndarray, last: np.ndarray) -> LaneNode:
    before, after = (tuple(sorted({pair[k] for pair in pairs})) for k in (0, 1))
    places = np.array([network.lines[i][-1] for i in before] + [network.lines[j][0] for j in after])
    headings = [last[i] for i in before] + [first[j] for j in after]
    if len(before) != len(after) and min(len(before), len(after)) == 1:  # the single lane keeps its direction
        headings = [last[before[0]]] if len(before) == 1 else [first[after[0]]]
    heading = float(np.angle(np.exp(1j * np.array(headings)).sum()))
    return LaneNode(before, after, tuple(pairs), places.mean(0), heading)


def meeting_lines(
    network: LaneNetwork, nodes: list[LaneNode]
) -> tuple[list[np.ndarray], Float64[np.ndarray, "lanes 2"]]:
    """The lines of all lanes with their ends moved to the nodes, and the directions at both ends [rad]."""
    lines = list(network.lines)
    headings = np.stack(_end_headings(network), -1)
    for node in nodes:
        for j in node.after:
            lines[j] = _moved(lines[j], node.place - lines[j][0])
            headings[j, 0] = node.heading
        for i in node.before:
            lines[i] = _moved(lines[i][::-1], node.place - lines[i][-1])[::-1]
            headings[i, 1] = node.heading
    return lines, headings


def _moved(line: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """A line with its first point moved by ``shift`` [m], and those after it less and less; the last one stays."""
    size = float(np.linalg.norm(shift))
    if size < 1e-9:
        return line
    arc = cumulative_length(line)
    reach = min(max(_LEAST_REACH, _REACH * size), float(arc[-1]))
    if size > 0.01:
        parts = np.where(arc[:-1] < reach, np.maximum(np.ceil(np.diff(arc) / _FINE_STEP), 1), 1).astype(int)
        row = np.repeat(np.arange(len(parts)), parts)
        share = (np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[row]
        places = np.append(arc[:-1][row] + share * np.diff(arc)[row], arc[-1])
        line = np.stack([np.interp(places, arc, column) for column in line.T], -1)
        arc = places
    return line + smoothstep(1 - arc / reach)[:, None] * shift
