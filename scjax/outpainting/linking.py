"""New lanes that meet each other, and the open ends of the map that they continue."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from scjax.outpainting.bends import Bends, Joint, is_met, line_to
from scjax.outpainting.coverage import OpenEnd, outward_heading
from scjax.outpainting.seams import find_joints
from scjax.outpainting.tile_agents import move_beside
from scjax.scene import MapLane
from scjax.scene.angles import wrap_to_pi

_NO_GAP = 1e-3  # m between ends that are one place
_INNER_GAP = 1.5  # m between new lanes that are listed as connected
_CLOSE_GAP, _CLOSE_TURN = 1.0, np.deg2rad(30.0)  # of new lanes that are connected although they are not listed


class LinkedLanes(NamedTuple):
    """New lanes, and what they continue.

    Attributes:
      lines: their points in the frame of the map [m].
      edges: pairs of lines, the second of which follows the first.
      joints: ends of lines at open ends of the map, with less than 5 degrees between them. The place is equal bit for
        bit, or within 5 cm where lanes of the map split or merge (``moved_lanes``).
    """

    lines: list[Float64[np.ndarray, "_ 3"]]
    edges: list[tuple[int, int]]
    joints: list[Joint]


def link_lanes(
    lines: Sequence[Float64[np.ndarray, "_ 3"]],
    listed: Sequence[tuple[int, int]],
    open_ends: Sequence[OpenEnd],
    agents: Float64[np.ndarray, "agents 9"],
    types: Int[np.ndarray, " agents"],
) -> tuple[LinkedLanes, Float64[np.ndarray, "agents 9"]]:
    """Lanes that are bent to meet each other and open ends, and the agents that move with them.

    Args:
      lines: in the frame of the map [m].
      listed: pairs of lines that are said to follow each other.
      agents: moved with the lanes beside which they are.
      types: ``AgentType``.
    """
    joints = find_joints(lines, open_ends, listed)
    met, closing = _closing(lines, listed, {(joint.lane, joint.at_start) for joint in joints})
    closed, agents = _bent(lines, met, list(closing.values()), agents, types)
    edges = [(a, b) for a, b in (*met, *closing) if _gap(closed[b][0], closed[a][-1]) <= _NO_GAP]
    bent, agents = _bent(closed, edges, joints, agents, types)
    return LinkedLanes(bent, edges, [joint for joint in joints if is_met(bent[joint.lane], joint)]), agents


def moved_lanes(
    lines: Sequence[Float64[np.ndarray, "_ 3"]], joints: Sequence[Joint], lanes: Mapping[str, MapLane]
) -> dict[str, MapLane]:
    """Lanes of the map, by their ids, whose open ends are brought to exactly where new lanes meet them."""
    moved: dict[str, MapLane] = {}
    for joint in joints:
        place, end = lines[joint.lane][0 if joint.at_start else -1], joint.open_end
        if not np.array_equal(place[:2], end.place[:2]):
            lane = moved.get(end.lane_id, lanes[end.lane_id])
            moved[lane.id] = dataclasses.replace(lane, points=line_to(lane.points, place, end.is_start))
    return moved


def _closing(
    lines: Sequence[np.ndarray], edges: Sequence[tuple[int, int]], joined: set[tuple[int, bool]]
) -> tuple[list[tuple[int, int]], dict[tuple[int, int], Joint]]:
    """Connections without a gap, and others with the joints that close them; ends that are ``joined`` get no more."""
    loose_starts = set(range(len(lines))) - {b for _, b in edges} - {lane for lane, start in joined if start}
    loose_ends = set(range(len(lines))) - {a for a, _ in edges} - {lane for lane, start in joined if not start}
    close = [(a, b) for a in sorted(loose_ends) for b in sorted(loose_starts) if a != b]
    met, moved = [], {}
    for row, (a, b) in enumerate([*edges, *close]):
        gap, outward = _gap(lines[b][0], lines[a][-1]), outward_heading(lines[a], False) or 0.0
        turn = abs(wrap_to_pi((outward_heading(lines[b], True) or 0.0) + np.pi - outward))
        is_listed = row < len(edges)
        if gap > (_INNER_GAP if is_listed else _CLOSE_GAP) or (not is_listed and turn > _CLOSE_TURN):
            continue
        if gap <= _NO_GAP:
            met.append((a, b))
        elif (b, True) not in joined and b not in moved:
            moved[b] = a, Joint(b, True, OpenEnd("", False, lines[a][-1], outward, False))
    return met, {(a, b): joint for b, (a, joint) in moved.items()}


def _bent(
    lines: Sequence[np.ndarray],
    edges: Sequence[tuple[int, int]],
    joints: Sequence[Joint],
    agents: np.ndarray,
    types: np.ndarray,
) -> tuple[list[np.ndarray], np.ndarray]:
    """Lines that meet the ends of their joints, and agents that go with them."""
    if not joints:
        return list(lines), agents
    bends = Bends(lines, edges, joints)
    return bends.lines(), move_beside(agents, types, lines, bends)


def _gap(one: Float64[np.ndarray, " 3"], other: Float64[np.ndarray, " 3"]) -> float:
    return float(np.hypot(*(one - other)[:2]))
