"""How far lanes lie on each other behind a fork and before a merge."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from scjax.export.roads.lane_curves import LaneCurve, curve_line
from scjax.export.roads.lane_nodes import LaneNode
from scjax.export.traffic import LANE_WIDTH

LEAST_LENGTH, MOST_LENGTH = 8.0, 80.0
"""Bounds of the part of a lane that lies in the junction of its fork or merge [m]."""

_CLEARANCE = 0.3  # m between the borders of two lanes that lie beside each other
_STEP = 1.0  # m


def fork_lengths(curves: Sequence[LaneCurve], nodes: Sequence[LaneNode]) -> tuple[list[float], list[float]]:
    """Lengths of the parts of all lanes at their starts and at their ends that lie on another lane of the node [m]."""
    heads, tails = [LEAST_LENGTH] * len(curves), [LEAST_LENGTH] * len(curves)
    for node in nodes:
        for lanes, lengths, step in ((node.after, heads, 1), (node.before, tails, -1)):
            lines = {lane: _line(curves[lane], step) for lane in lanes} if len(lanes) > 1 else {}
            for a, b in itertools.combinations(lines, 2):
                shared = _shared_length(lines[a], lines[b])
                lengths[a], lengths[b] = max(lengths[a], shared), max(lengths[b], shared)
    return heads, tails


def _line(curve: LaneCurve, step: int) -> np.ndarray:
    """Places on a curve, ``_STEP`` apart, from its start or its end on."""
    points, arc = curve_line(curve, _STEP)
    arc = arc if step == 1 else (arc[-1] - arc)[::-1]
    at = np.arange(0.0, min(arc[-1], MOST_LENGTH), _STEP)
    return np.stack([np.interp(at, arc, column) for column in points[::step, :2].T], -1)


def _shared_length(a: np.ndarray, b: np.ndarray) -> float:
    count = min(len(a), len(b))
    apart = np.hypot(*(a[:count] - b[:count]).T) > LANE_WIDTH + _CLEARANCE
    return float(apart.argmax() * _STEP) if apart.any() else count * _STEP
