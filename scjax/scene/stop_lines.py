"""How pictures show signals: a line across each lane that a signal controls."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene.log import Log
from scjax.scene.stop_points import stop_points

_WIDTH = 3.2  # m
_TOGETHER = 1.5  # m; signals whose stop points are nearer share one line


class StopLines(NamedTuple):
    """Lines across lanes.

    Attributes:
      rows: index of the signal of each line.
      ends: both ends of each line [m].
    """

    rows: Int[np.ndarray, " lines"]
    ends: Float64[np.ndarray, "lines 2 2"]


def stop_lines(log: Log) -> StopLines:
    """A line for each of ``stop_points``.

    Lanes that part at one place have signals there that may differ: each gets its share of the line, and they lie side
    by side as the lanes end.
    """
    points = stop_points(log)
    left = np.stack([-points.directions[:, 1], points.directions[:, 0]], -1)
    ends = np.zeros((len(left), 2, 2))
    leaders = points.groups(_TOGETHER).argmax(1) if len(left) else np.zeros(0, int)
    for leader in np.unique(leaders):
        members = np.flatnonzero(leaders == leader)
        aside = (points.ends[members] - points.positions[leader]) @ left[leader]
        members = members[np.argsort(-aside, kind="stable")]  # from left to right
        cuts = _WIDTH * (0.5 - np.arange(len(members) + 1) / len(members))
        for k, member in enumerate(members):
            ends[member] = points.positions[leader] + cuts[k : k + 2, None] * left[leader]
    return StopLines(points.signals, ends)
