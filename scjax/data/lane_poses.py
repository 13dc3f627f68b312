"""Poses along the lanes of a map without traffic: an ego that stands there, so that the map gives records."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.data.lane_graph import LaneGraph, SegmentIndex
from scjax.data.tiles import Pose, pose_of
from scjax.scene import NO_EGO, AgentType, Log

SPACING = 16.0  # m between two poses


def lane_poses(log: Log, graph: LaneGraph, index: SegmentIndex, count: int) -> tuple[Log, LaneGraph, list[Pose]]:
    """A log of the same map with one vehicle at each of ``count`` steps, its graph, and the poses of these vehicles.

    The vehicles stand on lanes and head along them, at least 16 m apart; their speeds and sizes are not known. Objects
    of the log are left out. A map with less road gives fewer poses.
    """
    places, headings = _places(graph, count)
    number = len(places)
    if not number:
        return log, graph, []
    positions = np.full((number, number, 3), np.nan)
    positions[range(number), range(number)] = places
    steps = dataclasses.replace(
        log,
        timestamps=np.arange(number, dtype=np.float64),
        object_ids=tuple(f"ego {k}" for k in range(number)),
        object_types=np.full(number, AgentType.VEHICLE, np.int32),
        valid=np.eye(number, dtype=bool),
        positions=positions,
        headings=np.diag(headings),
        velocities=np.full((number, number, 2), np.nan),
        sizes=np.full((number, 3), np.nan),
        ego_index=NO_EGO,
        signal_states=np.repeat(log.signal_states[:, :1], number, 1),
    )
    graph = dataclasses.replace(graph, signals=np.repeat(graph.signals[:, :1], number, 1))
    return steps, graph, [pose_of(steps, index, k, k) for k in range(number)]


def _places(graph: LaneGraph, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places on lanes [places, 3] and the headings there, spread over the map."""
    candidates, headings = [], []
    for start, end in zip(graph.offsets[:-1], graph.offsets[1:], strict=True):
        line = graph.points[start:end]
        steps = np.hypot(*np.diff(line[:, :2], axis=0).T)
        arc = np.concatenate([[0.0], np.cumsum(steps)])
        middle = np.arange(arc[-1] % SPACING / 2, arc[-1], SPACING)
        row = np.clip(np.searchsorted(arc, middle, side="right") - 1, 0, len(steps) - 1)
        ratio = ((middle - arc[row]) / steps[row])[:, None]
        candidates.append(line[row] + ratio * (line[row + 1] - line[row]))
        direction = line[row + 1] - line[row]
        headings.append(np.arctan2(direction[:, 1], direction[:, 0]))
    places, angles = np.concatenate(candidates), np.concatenate(headings)
    chosen = [0] if len(places) else []
    distance = np.full(len(places), np.inf)
    while chosen and len(chosen) < count:
        distance = np.minimum(distance, np.hypot(*(places - places[chosen[-1]])[:, :2].T))
        if distance.max() < SPACING:
            break
        chosen.append(int(distance.argmax()))
    return places[chosen], angles[chosen]
