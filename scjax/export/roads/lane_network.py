"""The lanes of a log as exports need them: clean lines with z, who follows whom, and who runs beside whom."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.data.join_options import JoinOptions
from scjax.data.lane_graph import distinct_points
from scjax.data.lane_joins import inferred_joins, recorded_joins
from scjax.data.neighbors import infer_neighbors, recorded_neighbors
from scjax.export.base import Losses
from scjax.scene import Log, MapLane
from scjax.scene.polyline import cumulative_length


class LaneBeside(NamedTuple):
    """A lane beside another one that runs the same way.

    Attributes:
      lane: index of the lane beside.
      own: arc lengths on the lane itself at which that begins and ends [m].
      other: the same on the lane beside [m].
    """

    lane: int
    own: tuple[float, float]
    other: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class LaneNetwork:
    """Lanes with a length, and their relations as indices.

    Attributes:
      lanes: as in the log, without those of no length.
      lines: their centerlines without repeated points; z is known everywhere [m].
      successors, predecessors: lanes after and before each lane.
      left, right: lanes beside each lane.
    """

    lanes: tuple[MapLane, ...]
    lines: tuple[Float64[np.ndarray, "_ 3"], ...]
    successors: tuple[tuple[int, ...], ...]
    predecessors: tuple[tuple[int, ...], ...]
    left: tuple[tuple[LaneBeside, ...], ...]
    right: tuple[tuple[LaneBeside, ...], ...]

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All (i, j) where lane j follows lane i."""
        return [(i, j) for i, following in enumerate(self.successors) for j in following]


def lane_network(log: Log, losses: Losses) -> LaneNetwork:
    """The lanes of ``log``; relations that it does not record are inferred as for training records.

    Raises:
      ValueError: no lane has a length.
    """
    lanes, lines = [], []
    for lane in log.lanes:
        line = distinct_points(lane.points)
        if len(line) >= 2:
            lanes.append(lane)
            lines.append(line.copy())
    losses["lanes of no length, left out"] += len(log.lanes) - len(lanes)
    if not lanes:
        raise ValueError("the log has no lane with a length: this format needs a road, export a log with a map")
    unknown = sum(bool(np.isnan(line[:, 2]).any()) for line in lines)
    losses["lanes without a height, written at that of the nearest lane or at 0 m"] += unknown
    _fill_heights(lines)
    joins = recorded_joins(lanes, lines) if log.has_topology else inferred_joins(lines, JoinOptions())
    for name, count in joins.warnings.items():
        losses[name] += count
    successors: list[list[int]] = [[] for _ in lanes]
    predecessors: list[list[int]] = [[] for _ in lanes]
    for i, j in sorted(joins.pairs):
        successors[i].append(j)
        predecessors[j].append(i)
    left, right = _lanes_beside(log.has_topology, lanes, lines)
    return LaneNetwork(
        tuple(lanes),
        tuple(lines),
        tuple(map(tuple, successors)),
        tuple(map(tuple, predecessors)),
        left,
        right,
    )


def _fill_heights(lines: list[np.ndarray]) -> None:
    """Gives lines without z the height of the nearest point that has one, or 0."""
    from scipy.spatial import KDTree

    unknown = [line for line in lines if np.isnan(line[:, 2]).any()]
    known = [line for line in lines if not np.isnan(line[:, 2]).any()]
    if not known:
        for line in unknown:
            line[:, 2] = 0.0
    elif unknown:
        points = np.concatenate(known)
        tree = KDTree(points[:, :2])
        for line in unknown:
            line[:, 2] = points[tree.query(line[:, :2])[1], 2]


def _lanes_beside(
    is_recorded: bool, lanes: list[MapLane], lines: list[np.ndarray]
) -> tuple[tuple[tuple[LaneBeside, ...], ...], tuple[tuple[LaneBeside, ...], ...]]:
    """Lanes on the left and on the right of each lane."""
    offsets = np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int64)
    stacked = np.concatenate(lines)
    if is_recorded:
        pairs, spans, _ = recorded_neighbors(lanes, [[row] for row in range(len(lanes))], stacked, offsets)
    else:
        pairs, spans = infer_neighbors(stacked, offsets)
    left: list[list[LaneBeside]] = [[] for _ in lanes]
    right: list[list[LaneBeside]] = [[] for _ in lanes]
    for (i, j), span in zip(pairs.tolist(), spans.tolist(), strict=True):
        right[i].append(LaneBeside(j, (span[0], span[1]), (span[2], span[3])))
        left[j].append(LaneBeside(i, (span[2], span[3]), (span[0], span[1])))
    return tuple(map(tuple, left)), tuple(map(tuple, right))


def line_headings(line: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Direction of a polyline at each of its points, the mean of both sides [rad]."""
    steps = np.diff(line[:, :2], axis=0)
    units = steps / np.hypot(*steps.T)[:, None]
    mean = np.concatenate([units[:1], units[:-1] + units[1:], units[-1:]])
    turned = np.hypot(*mean.T) < 1e-6  # it turns back: the direction of the step that leaves
    mean[turned] = np.concatenate([units, units[-1:]])[turned]
    return np.arctan2(mean[:, 1], mean[:, 0])


def border_line(
    line: Float64[np.ndarray, "n 3"], offset: float, ends: tuple[float, float] | None = None
) -> Float64[np.ndarray, "n 3"]:
    """A line beside a polyline, ``offset`` to the left of it [m].

    Args:
      ends: directions at both ends [rad]; those of the polyline by default.
    """
    heading = line_headings(line)
    if ends is not None:
        heading[0], heading[-1] = ends
    aside = np.stack([-np.sin(heading), np.cos(heading), np.zeros(len(line))], -1)
    return line + offset * aside


def index_at(line: Float64[np.ndarray, "n 3"], arc: float) -> int:
    """Index of the point of a polyline nearest to an arc length [m]."""
    return int(np.abs(cumulative_length(line) - arc).argmin())
