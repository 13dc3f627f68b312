"""Where lanes cross: clusters of crossings, their arms, and what kind of intersection each one is.

Arms are counted by the headings with which lanes enter and leave, not by where they do: wide arms smear places by 25
degrees, headings by 5, and connectors carry the headings of arms that lie outside the window.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from scjax.language.road import Road, wrapped

Kind = Literal["four-way", "T", "complex"]
Side = Literal["ahead", "behind", "left", "right", "inside"]

CROSS = np.deg2rad((35.0, 145.0))  # angle between two lanes that cross
CROSS_SIBLINGS = np.deg2rad((60.0, 120.0))  # of lanes that share a predecessor or a successor
LEVELS = 3.0  # metres of height between lanes that pass over each other
_LINK = 12.0  # metres between crossings of one intersection
_MARGIN = 10.0  # metres from the outermost crossing to the end of the intersection
_CONNECTOR = (45.0, 0.5)  # longest connector [m] and least turn [rad] of lanes that join without crossing
_ARM_GAP = np.deg2rad(28.0)
_ARM_HEADINGS, _MANY_HEADINGS = 2, 10  # that an arm has at least, where so many are found
_STILL_TURNING = 0.12  # rad over the last tenth of a lane
_BORDER = 31.0  # metres
_RAMP = 25.0  # metres of turn radius above which a turn is no turn at an intersection
_STEP = 3.0  # metres between the points of a ring whose roundness is judged
_STRIDE = 4  # points of a lane in the search for crossings


@dataclasses.dataclass(frozen=True)
class Intersection:
    """Crossing lanes in one place.

    Attributes:
      centre, radius: disc that holds the crossings and 10 m more.
      members: lanes that cross or connect in it.
      arms: directions away from it [rad].
      crossings: number of crossing pairs of lanes.
    """

    centre: np.ndarray
    radius: float
    members: tuple[int, ...]
    arms: tuple[float, ...]
    crossings: int

    @property
    def kind(self) -> Kind | None:
        """None for fewer than three arms: lanes cross, but no roads do."""
        if len(self.arms) < 3:
            return None
        return "T" if len(self.arms) == 3 else "four-way" if len(self.arms) == 4 else "complex"

    @property
    def distance(self) -> float:
        """From the ego to the centre [m]."""
        return float(np.hypot(*self.centre))

    @property
    def side(self) -> Side:
        """Where it lies as seen by the ego."""
        if self.distance < self.radius - 6:
            return "inside"
        return side_of(self.centre)


def side_of(place: np.ndarray) -> Literal["ahead", "behind", "left", "right"]:
    """Quarter of the plane around the ego."""
    bearing = np.arctan2(place[1], place[0])
    if abs(bearing) <= np.pi / 4:
        return "ahead"
    if abs(bearing) >= 3 * np.pi / 4:
        return "behind"
    return "left" if bearing > 0 else "right"


def find_intersections(road: Road) -> tuple[list[Intersection], int]:
    """Intersections of three or more arms, those with most crossings first; pairs of lanes on different levels.

    Lanes that on average cross each other more than once, as those of untrained models do, are a tangle without any.
    """
    places, pairs, bridges = _crossings(road)
    if not len(places) or len(places) > len(road) * (len(road) - 1) // 2:
        return [], bridges
    near = np.linalg.norm(places[:, None] - places[None], axis=-1) < _LINK
    label = connected_components(csr_array(near), directed=False)[1]
    found = []
    for number in range(label.max() + 1):
        points = places[label == number]
        centre = points.mean(0)
        radius = float(np.linalg.norm(points - centre, axis=-1).max()) + _MARGIN
        members = set(pairs[label == number].ravel().tolist()) | _connectors(road, centre, radius)
        made = Intersection(
            centre, radius, tuple(sorted(members)), _arms(road, members, centre, radius), int((label == number).sum())
        )
        if made.kind is not None and not _is_interchange(road, members):
            found.append(made)
    return sorted(found, key=lambda item: (-item.crossings, item.distance, *item.centre)), bridges


def has_roundabout(road: Road) -> bool:
    """A ring of lanes, round and nowhere straight for long: loops of parking lots and city blocks are neither."""
    for start in range(len(road)):
        ring = _ring(road, start)
        if ring and _is_round(road, ring):
            return True
    return False


def _crossings(road: Road) -> tuple[np.ndarray, np.ndarray, int]:
    """Places [n, 2] and lanes [n, 2] of crossings; number of pairs that cross on different levels."""
    if len(road) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2), int), 0
    line, z = road.line[:, ::_STRIDE], road.z[:, ::_STRIDE]
    i, j = np.triu_indices(len(road), 1)
    low, high = line.min(1), line.max(1)
    meet = ((low[i] <= high[j]) & (low[j] <= high[i])).all(-1)
    i, j = i[meet], j[meet]
    p, r = line[:, :-1], np.diff(line, axis=1)
    a, b = p[i][:, :, None], p[j][:, None]
    da, db = r[i][:, :, None], r[j][:, None]
    cross = da[..., 0] * db[..., 1] - da[..., 1] * db[..., 0]
    apart = b - a
    safe = np.where(np.abs(cross) > 1e-9, cross, np.inf)
    s = (apart[..., 0] * db[..., 1] - apart[..., 1] * db[..., 0]) / safe
    t = (apart[..., 0] * da[..., 1] - apart[..., 1] * da[..., 0]) / safe
    angle = np.abs(np.arctan2(cross, (da * db).sum(-1)))
    sibling = np.array([bool(_siblings(road, int(m), int(n))) for m, n in zip(i, j, strict=True)], bool)
    low_angle = np.where(sibling, CROSS_SIBLINGS[0], CROSS[0])[:, None, None]
    high_angle = np.where(sibling, CROSS_SIBLINGS[1], CROSS[1])[:, None, None]
    hit = (np.abs(cross) > 1e-9) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    pair, m, n = np.nonzero(hit & (angle >= low_angle) & (angle <= high_angle))
    height = np.abs(z[i[pair], m] - z[j[pair], n])
    level = ~(height > LEVELS)  # NaN: unknown, taken as level
    places = p[i[pair], m] + s[pair, m, n][:, None] * r[i[pair], m]
    bridges = len(set(pair[~level].tolist()))
    return places[level], np.stack([i[pair], j[pair]], 1)[level], bridges


def _siblings(road: Road, i: int, j: int) -> bool:
    same_start = set(road.predecessors[i]) & set(road.predecessors[j])
    return bool(same_start or set(road.successors[i]) & set(road.successors[j]))


def _connectors(road: Road, centre: np.ndarray, radius: float) -> set[int]:
    """Short turning lanes in the disc that start at a fork or end at a merge: right turns never cross anything."""
    longest, least = _CONNECTOR
    inside = (np.linalg.norm(road.line - centre, axis=-1) < radius).any(1)
    turning = inside & (road.length < longest) & (np.abs(road.turn) > least)
    return {
        int(lane)
        for lane in np.flatnonzero(turning)
        if any(len(road.successors[before]) > 1 for before in road.predecessors[lane])
        or any(len(road.predecessors[after]) > 1 for after in road.successors[lane])
    }


def _arms(road: Road, members: set[int], centre: np.ndarray, radius: float) -> tuple[float, ...]:
    """Directions, away from the intersection, of the roads that meet in it.

    Where there are many headings, a single one is no road: a connector that the disc or the window cuts within its
    turn, or a lane end that a model has drawn askew.
    """
    directions = []
    for lane in members:
        inside = np.flatnonzero(np.linalg.norm(road.line[lane] - centre, axis=-1) < radius)
        if not len(inside):
            continue
        enter, leave = int(inside[0]), int(inside[-1])
        chord = road.chord[lane]
        ends = ((enter, 0, chord[min(enter, len(chord) - 1)] + np.pi), (leave, 1, chord[max(leave - 1, 0)]))
        for point, end, direction in ends:
            at_border = np.abs(road.line[lane, point]).max() > _BORDER
            if not (at_border and road.turn_at_ends[lane, end] > _STILL_TURNING):
                directions.append(float(wrapped(direction)))
    groups, least = _circular_clusters(directions), _ARM_HEADINGS if len(directions) >= _MANY_HEADINGS else 1
    return tuple(
        float(np.arctan2(np.sin(group).mean(), np.cos(group).mean())) for group in groups if len(group) >= least
    )


def _circular_clusters(angles: list[float]) -> list[np.ndarray]:
    """Groups of directions, parted by gaps of more than 28 degrees."""
    if not angles:
        return []
    ordered = np.sort(np.array(angles))
    gaps = np.append(np.diff(ordered), ordered[0] + 2 * np.pi - ordered[-1])
    # Start behind a gap, so that no group is cut at +-pi.
    ordered = np.roll(ordered, -1 - int(gaps.argmax()))
    return np.split(ordered, np.flatnonzero(np.diff(ordered) % (2 * np.pi) > _ARM_GAP) + 1)


def _is_interchange(road: Road, members: set[int]) -> bool:
    """Whether every lane that turns does so on a radius of a ramp: by arms a T, in truth a merge."""
    turning = [lane for lane in members if abs(road.turn[lane]) > 0.35]
    if not turning:
        return False
    radius = [road.length[lane] / abs(road.turn[lane]) for lane in turning]
    return bool(min(radius) > _RAMP and all(abs(road.turn[lane]) < 1.2 for lane in turning))


def _ring(road: Road, start: int, most: int = 16) -> list[int]:
    """A shortest way from a lane back to itself; empty without any."""
    came: dict[int, int] = {}
    level = [start]
    for _ in range(most):
        fresh = []
        for lane, after in itertools.chain.from_iterable(((x, y) for y in road.successors[x]) for x in level):
            if after == start:
                path = [lane]
                while path[-1] != start:
                    path.append(came[path[-1]])
                return path[::-1]
            if after not in came:
                came[after] = lane
                fresh.append(after)
        level = fresh
    return []


def _is_round(road: Road, ring: list[int]) -> bool:
    line = _even(np.concatenate([road.line[lane][:-1] for lane in ring]))
    step = np.roll(line, -1, 0) - line
    heading, length = np.arctan2(step[:, 1], step[:, 0]), np.linalg.norm(step, axis=-1)
    bend = wrapped(np.roll(heading, -1) - heading)
    turn = abs(bend.sum())  # clockwise where traffic keeps to the left
    if not 35 <= length.sum() <= 220 or not 5.2 <= turn <= 7.4:
        return False
    from_middle = np.linalg.norm(line - line.mean(0), axis=-1)
    straight = (np.abs(bend) < 0.02 * length).mean()
    steady = np.abs(bend).sum() < 1.35 * turn and from_middle.std() < 0.2 * from_middle.mean()
    return bool(steady and straight < 0.2)


def _even(ring: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "even 2"]:
    """Points of a closed line about ``_STEP`` apart: closer ones would lie between the corners of its lanes."""
    closed = np.concatenate([ring, ring[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=-1))])
    wanted = np.linspace(0, along[-1], max(round(along[-1] / _STEP), 8), endpoint=False)
    return np.stack([np.interp(wanted, along, column) for column in closed.T], -1)
