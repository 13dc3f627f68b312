"""Where lanes part and where they meet."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from scjax.language.analysis.lane_lines import LaneLines
from scjax.language.analysis.routes import pose_after
from scjax.scene.angles import wrap_to_pi

_COMPARISON_DISTANCE = 22.0  # m from the fork, at which its branches are compared
_SAME_PLACE, _SAME_HEADING, _SAME_HEIGHT = 1.0, np.deg2rad(30.0), 1.5  # m, rad, m of lanes that begin together
_MIN_TURN = float(np.deg2rad(38.0))  # between branches of a junction
_MIN_GAP = 2.2  # m between branches that are apart


class Parting(NamedTuple):
    """Lanes that begin, or end, in one place.

    Attributes:
      is_fork: the lanes begin here; otherwise they end here.
      place: x, y, z [m].
      branches: the lanes.
      spread: largest angle between two branches 22 m on [rad].
      gap: largest distance between two branches 22 m on, or where the shorter one ends [m].
    """

    is_fork: bool
    place: np.ndarray
    branches: tuple[int, ...]
    spread: float
    gap: float

    @property
    def is_turn(self) -> bool:
        """Whether the branches turn apart, as in a junction."""
        return self.spread > _MIN_TURN

    @property
    def is_split(self) -> bool:
        """Whether the branches run apart without a turn."""
        return not self.is_turn and self.gap > _MIN_GAP


def find_partings(lines: LaneLines) -> list[Parting]:
    """All places where two lanes or more begin together or end together."""
    return [
        _parting(lines, branches, is_fork)
        for is_fork in (True, False)
        for branches in sorted(_branch_groups(lines, is_fork))
    ]


def _branch_groups(lines: LaneLines, is_fork: bool) -> set[tuple[int, ...]]:
    """Lanes with a common lane before (after) them, and lanes without any that begin (end) in one place."""
    table, back = (lines.next, lines.follows.any(0)) if is_fork else (lines.previous, lines.follows.any(1))
    groups = {tuple(branches) for branches in table if len(branches) > 1}
    lanes = np.flatnonzero(~back)
    column = 0 if is_fork else -1
    ends, headings = lines.points[lanes, column], lines.headings[lanes, column]
    offset = ends[:, None] - ends[None]
    together = (np.hypot(offset[..., 0], offset[..., 1]) < _SAME_PLACE) & (np.abs(offset[..., 2]) < _SAME_HEIGHT)
    together &= np.abs(wrap_to_pi(headings[:, None] - headings[None])) < _SAME_HEADING
    groups |= {tuple(lanes[row].tolist()) for row in together if row.sum() > 1}
    return groups


def _parting(lines: LaneLines, branches: tuple[int, ...], is_fork: bool) -> Parting:
    ways = [pose_after(lines, lane, _COMPARISON_DISTANCE, ahead=is_fork) for lane in branches]
    spread = gap = 0.0
    for (a, (first, first_reach)), (b, (second, second_reach)) in itertools.combinations(enumerate(ways), 2):
        spread = max(spread, abs(float(wrap_to_pi(first[2] - second[2]))))
        reach = min(first_reach, second_reach)
        if first_reach > reach + 1:
            first, _ = pose_after(lines, branches[a], reach, ahead=is_fork)
        if second_reach > reach + 1:
            second, _ = pose_after(lines, branches[b], reach, ahead=is_fork)
        gap = max(gap, float(np.hypot(*(first[:2] - second[:2]))))
    place = lines.points[branches[0], 0 if is_fork else -1]
    return Parting(is_fork, place, branches, spread, gap)
