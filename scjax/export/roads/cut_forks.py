"""Forks and merges that the border of a scene cut: lanes that begin or end at one place share a road there.

Without it each is a road of its own, and several lie on top of each other up to the border. Simulators would put
vehicles into each other there.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float64

from scjax.export.base import Losses
from scjax.export.roads.lane_network import LaneNetwork
from scjax.scene import MapLane
from scjax.scene.polyline import cumulative_length

SHARED_LENGTH = 4.0
"""How much of lanes that begin or end at one place is one road [m]."""

_APART = 1.0  # m; lanes of one place are nearer than this to their mean
_MAX_TURN = float(np.deg2rad(15.0))
_LEAST_REST = 4.0  # m of a lane that stays


def join_cut_forks(network: LaneNetwork, losses: Losses) -> LaneNetwork:
    """Lanes that nothing leads to and that begin at one place follow a new lane; those that end at one lead to one.

    The new lane is the mean of what they share. Lanes of different types share nothing.
    """
    for at_end in (False, True):
        network = _join(network, at_end, losses)
    return network


def _join(network: LaneNetwork, at_end: bool, losses: Losses) -> LaneNetwork:
    """Joins at the starts of lanes, or at their ends."""
    neighbors = network.successors if at_end else network.predecessors
    lines = [line[::-1] if at_end else line for line in network.lines]
    parts = {
        row: _first_part(line)
        for row, line in enumerate(lines)
        if not neighbors[row] and cumulative_length(line)[-1] >= SHARED_LENGTH + _LEAST_REST
    }
    lanes, lines = list(network.lanes), list(network.lines)
    successors, predecessors = list(network.successors), list(network.predecessors)
    for group in _groups(network, parts):
        mean = np.mean([parts[row] for row in group], axis=0)
        number = len(lanes)
        name = "+".join(network.lanes[row].id for row in group)
        lanes.append(MapLane(name, network.lanes[group[0]].lane_type, mean[::-1] if at_end else mean))
        lines.append(lanes[-1].points)
        successors.append(() if at_end else group)
        predecessors.append(group if at_end else ())
        for row in group:
            lines[row] = _rest(network.lines[row], at_end)
            (successors if at_end else predecessors)[row] = (number,)
        losses["lanes that begin or end at one place, which share a road there"] += len(group)
    blank = ((),) * (len(lanes) - len(network.lanes))
    return dataclasses.replace(
        network,
        lanes=tuple(lanes),
        lines=tuple(lines),
        successors=tuple(successors),
        predecessors=tuple(predecessors),
        left=network.left + blank,
        right=network.right + blank,
    )


def _first_part(line: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "5 3"]:
    """Points at even steps on the first ``SHARED_LENGTH`` of a line."""
    arc = cumulative_length(line)
    return np.stack([np.interp(np.linspace(0.0, SHARED_LENGTH, 5), arc, column) for column in line.T], -1)


def _rest(line: Float64[np.ndarray, "n 3"], at_end: bool) -> Float64[np.ndarray, "m 3"]:
    """A line without the part that it shares at its start or end."""
    arc = cumulative_length(line)
    cut = arc[-1] - SHARED_LENGTH if at_end else SHARED_LENGTH
    point = np.array([np.interp(cut, arc, column) for column in line.T])
    if at_end:
        return np.concatenate([line[arc < cut - 1e-6], point[None]])
    return np.concatenate([point[None], line[arc > cut + 1e-6]])


def _groups(network: LaneNetwork, parts: dict[int, np.ndarray]) -> list[tuple[int, ...]]:
    """Lanes whose first parts lie on top of each other, each in one group; each with the mean of its group."""
    groups: list[list[int]] = []
    for row, part in parts.items():
        for group in groups:
            others = np.mean([parts[other] for other in group], axis=0)
            if network.lanes[row].lane_type == network.lanes[group[0]].lane_type and _are_one(part, others):
                group.append(row)
                break
        else:
            groups.append([row])
    return [tuple(group) for group in groups if len(group) > 1]


def _are_one(part: Float64[np.ndarray, "n 3"], other: Float64[np.ndarray, "n 3"]) -> bool:
    """Whether two lines of as many points are near each other all along and run the same way."""
    headings = [np.arctan2(*(line[-1] - line[0])[1::-1]) for line in (part, other)]
    turn = abs(np.angle(np.exp(1j * (headings[1] - headings[0]))))
    return bool(turn < _MAX_TURN and np.linalg.norm(part - other, axis=-1).max() < _APART)
