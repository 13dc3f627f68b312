"""Roundabouts: a closed ring of lanes, or lanes that circulate around one place."""

from __future__ import annotations

import itertools

import numpy as np
from jaxtyping import Float

from scjax.language.road import Road, wrap_to_pi

_RING_SPACING = 3.0  # m between the points of a ring
_MIN_RING_POINTS = 8
_RING_LENGTH = (35, 220)  # m
_RING_TURN = (5.2, 7.4)  # rad
_MAX_RING_LANES = 16
_STRAIGHT_CURVATURE = 0.02  # rad/m, ring segments below are straight
_ARC_STEP = 2.0  # m between the places at which lanes are looked at
_ARC_LENGTH = 8.0  # m over which their curvature is measured
_RADIUS = (4.0, 30.0)  # m
_CENTER_SPREAD = 5.0  # m between the centers of arcs of one circulation
_RING_WIDTH = 0.3  # share of the radius, within which lanes belong to the ring
_BINS = 36  # of the circle
_MIN_COVERED = 24  # of them, 240 degrees
_MIN_ARCS = 8  # of one circulation
_MIN_ROADS = 2  # that enter or leave


def has_roundabout(road: Road) -> bool:
    """Whether lanes form a ring that is round and nowhere straight for long, unlike parking lots and city blocks.

    Without a closed ring of that kind, lanes that circulate around one place count too.
    """
    for start in range(len(road)):
        ring = _shortest_ring(road, start)
        if ring and _is_round(road, ring):
            return True
    return _circulates(road)


def _shortest_ring(road: Road, start: int) -> list[int]:
    """Lanes of a shortest way from ``start`` back to itself (breadth-first search); empty without one."""
    previous: dict[int, int] = {}
    level = [start]
    for _ in range(_MAX_RING_LANES):
        next_level = []
        for lane, successor in itertools.chain.from_iterable(((x, y) for y in road.successors[x]) for x in level):
            if successor == start:
                ring = [lane]
                while ring[-1] != start:
                    ring.append(previous[ring[-1]])
                return ring[::-1]
            if successor not in previous:
                previous[successor] = lane
                next_level.append(successor)
        level = next_level
    return []


def _is_round(road: Road, ring: list[int]) -> bool:
    line = _resample_ring(np.concatenate([road.points[lane][:-1] for lane in ring]))
    step = np.roll(line, -1, 0) - line
    heading, length = np.arctan2(step[:, 1], step[:, 0]), np.linalg.norm(step, axis=-1)
    bends = wrap_to_pi(np.roll(heading, -1) - heading)
    turn = abs(bends.sum())  # clockwise where traffic keeps to the left
    if not _RING_LENGTH[0] <= length.sum() <= _RING_LENGTH[1] or not _RING_TURN[0] <= turn <= _RING_TURN[1]:
        return False
    radius = np.linalg.norm(line - line.mean(0), axis=-1)
    straight_share = (np.abs(bends) < _STRAIGHT_CURVATURE * length).mean()
    is_steady = np.abs(bends).sum() < 1.35 * turn and radius.std() < 0.2 * radius.mean()
    return bool(is_steady and straight_share < 0.2)


def _resample_ring(ring: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "even 2"]:
    """Points of a closed line about 3 m apart; closer points would lie between the corners of its lanes."""
    closed = np.concatenate([ring, ring[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=-1))])
    count = max(round(arc[-1] / _RING_SPACING), _MIN_RING_POINTS)
    positions = np.linspace(0, arc[-1], count, endpoint=False)
    return np.stack([np.interp(positions, arc, column) for column in closed.T], -1)


def _circulates(road: Road) -> bool:
    """Whether lanes turn around one place in one sense, with roads that enter or leave.

    Finds what a closed ring misses: an open connection, a ring of two lanes, a ring that the window cuts.
    """
    centers, curvature = _arcs(road)
    for sense in (1, -1):
        rows = np.sign(curvature) == sense
        if rows.sum() < _MIN_ARCS:
            continue
        near = np.linalg.norm(centers[rows, None] - centers[rows][None], axis=-1) < _CENTER_SPREAD
        best = near[near.sum(1).argmax()]
        center = np.median(centers[rows][best], axis=0)
        radius = float(np.median(1 / np.abs(curvature[rows][best])))
        if best.sum() >= _MIN_ARCS and _is_circulation(road, sense, center, radius):
            return True
    return False


def _is_circulation(road: Road, sense: int, center: np.ndarray, radius: float) -> bool:
    """Whether lanes go round ``center`` in one sense [1: to the left], and others lead there."""
    place, heading = _lane_places(road)
    offset = place - center
    distance, angle = np.linalg.norm(offset, axis=-1), np.arctan2(offset[:, 1], offset[:, 0])
    if (distance < 0.5 * radius).any():  # a road through the middle
        return False
    around = np.cos(heading - (angle + sense * np.pi / 2)) > 0.9
    ring = around & (np.abs(distance - radius) < _RING_WIDTH * radius)
    covered = np.zeros(_BINS, bool)
    covered[((angle[ring] + np.pi) / (2 * np.pi) * _BINS).astype(int) % _BINS] = True
    if covered.sum() < _MIN_COVERED:
        return False
    ends = np.linalg.norm(road.points[:, [0, -1]] - center, axis=-1)
    meets = (np.abs(ends - radius) < _RING_WIDTH * radius + 2.0).any(1) & (
        ends.max(1) > radius * (1 + _RING_WIDTH) + 4.0
    )
    return int(meets.sum()) >= _MIN_ROADS


def _lane_places(road: Road) -> tuple[np.ndarray, np.ndarray]:
    """Places along all lanes [n, 2], 2 m apart, and the heading there [rad]."""
    places, headings = [np.zeros((0, 2))], [np.zeros(0)]
    for line, length in zip(road.points, road.length, strict=True):
        arc = np.linspace(0.0, length, max(int(length / _ARC_STEP), 1) + 1)
        fine = np.linspace(0.0, length, len(line))
        points = np.stack([np.interp(arc, fine, line[:, k]) for k in (0, 1)], -1)
        step = np.diff(points, axis=0)
        places.append(points[:-1] + step / 2)
        headings.append(np.arctan2(step[:, 1], step[:, 0]))
    return np.concatenate(places), np.concatenate(headings)


def _arcs(road: Road) -> tuple[np.ndarray, np.ndarray]:
    """Centers [n, 2] of the circles that lanes follow over 8 m, and their signed curvature [rad/m]."""
    centers, curvatures = [np.zeros((0, 2))], [np.zeros(0)]
    for line, length in zip(road.points, road.length, strict=True):
        step = length / (len(line) - 1)
        reach = int(np.clip(min(_ARC_LENGTH, length) / step - 1, 1, len(line) - 2))
        if length < _ARC_LENGTH / 2:
            continue
        direction = np.unwrap(np.arctan2(*np.diff(line, axis=0).T[::-1]))
        stride = max(int(_ARC_STEP / step), 1)
        turn = (direction[reach:] - direction[:-reach])[::stride] / (reach * step)
        middle = np.arange(len(direction) - reach)[::stride] + reach // 2
        curved = (np.abs(turn) > 1 / _RADIUS[1]) & (np.abs(turn) < 1 / _RADIUS[0])
        heading, place = direction[middle[curved]], line[middle[curved]]
        normal = np.stack([-np.sin(heading), np.cos(heading)], -1)
        centers.append(place + normal / turn[curved, None])
        curvatures.append(turn[curved])
    return np.concatenate(centers), np.concatenate(curvatures)
