"""Vehicles behind each other along their lanes, and queues of them."""

from __future__ import annotations

import numpy as np

from scjax.language.analysis.agent_lanes import AgentLanes
from scjax.language.analysis.lane_lines import LaneLines
from scjax.language.analysis.routes import reachable_lanes

REACH = 40.0  # m ahead, within which a leader is looked for
_MIN_AHEAD = 0.5  # m between the centers of a vehicle and its leader


def leader_gaps(
    lines: LaneLines, relations: AgentLanes, agents: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Leader of every vehicle of ``rows`` among them, along the links.

    Returns:
      Index into ``rows`` of each vehicle's leader, -1 without one; gap between the bumpers [m], infinite without one.
    """
    lane = relations.lane[rows]
    on_lane = lane >= 0
    gap = np.full((len(rows), len(rows)), np.inf)
    position = relations.point[rows, lane] * lines.spacing[lane] if len(lines) else np.zeros(len(rows))
    half = agents[rows, 6] / 2
    for start in np.unique(lane[on_lane]):
        starts = {int(start): 0.0}
        starts |= reachable_lanes(lines, int(start), 0, float(lines.length[start]) + REACH)
        offset = np.full(len(lines), np.inf)
        offset[list(starts)] = list(starts.values())
        behind = np.flatnonzero(lane == start)
        ahead = np.where(on_lane, offset[lane] + position, np.inf)
        distance = ahead[None] - position[behind, None]
        distance = np.where(distance > _MIN_AHEAD, distance, np.inf)
        gap[behind] = distance - half[behind, None] - half[None]
    if not len(rows):
        return np.zeros(0, int), np.zeros(0)
    leader = gap.argmin(1)
    least = gap.min(1)
    return np.where(np.isfinite(least), leader, -1), least


def longest_platoon(leader: np.ndarray, gap: np.ndarray, max_gap: float) -> int:
    """Most vehicles that follow each other with gaps below ``max_gap`` [m]; 0 without any vehicle."""
    follows = np.where(gap < max_gap, leader, -1)
    longest = 0
    for start in range(len(follows)):
        visited, last = {start}, int(follows[start])
        while last >= 0 and last not in visited:
            visited.add(last)
            last = int(follows[last])
        longest = max(longest, len(visited))
    return longest
