"""Junctions: places where lanes cross or turn apart, with the roads that lead there."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
from jaxtyping import Float64

from scjax.language.analysis.crossings import MAX_LEVEL, Crossings
from scjax.language.analysis.lane_lines import LaneLines
from scjax.language.analysis.partings import Parting
from scjax.scene.angles import wrap_to_pi

_CLUSTER_DISTANCE = 11.0  # m between neighboring points of one junction
_CONNECTOR_TURN = np.deg2rad(32.0)  # at least, of a lane that turns in a junction
_CONNECTOR_LENGTH = 45.0  # m at most, of a lane that lies in one junction only
_MARGINS = (2.0, 4.0, 7.0)  # m outside of the outermost point, where arms are counted
_MAX_BEND = np.deg2rad(2.2)  # per point; a lane that bends more turns inside a junction and is no arm
_BEND_REACH = 2  # points on both sides, over which that is measured
_MAX_EXTENT = 13.0  # m around its points, over which a junction may extend
_STRAIGHT = np.deg2rad(5.0)  # off the heading at an end of a lane, within which it is no bend yet
_ARM_ANGLE = np.deg2rad(28.0)  # between the lanes of one arm
_ARM_WIDTH = 9.0  # m between neighboring lanes of one arm
_BORDER_DISTANCE = 1.5  # m, lanes that end so near to the border go on behind it
_T_GAP, _T_OR_Y_GAP = np.deg2rad(150.0), np.deg2rad((140.0, 160.0))  # largest gap between the arms of a T


@dataclasses.dataclass(frozen=True)
class Crossroad:
    """A junction of at least three arms.

    Attributes:
      center: middle of its points and of the bends of the lanes that turn in it [m].
      points: where lanes cross, part and meet [m].
      radius: from the center to the outermost of them [m].
      arms: outward directions of its roads [rad], sorted.
    """

    center: Float64[np.ndarray, 2]
    points: Float64[np.ndarray, "points 2"]
    radius: float
    arms: tuple[float, ...]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Names that fit its arms, the best one first: "T", "Y", "four-way", "complex"."""
        if len(self.arms) != 3:
            return ("four-way",) if len(self.arms) == 4 else ("complex",)
        gap = float(np.diff([*self.arms, self.arms[0] + 2 * np.pi]).max())
        names = ("T", "Y") if gap >= _T_GAP else ("Y", "T")
        return names if _T_OR_Y_GAP[0] <= gap <= _T_OR_Y_GAP[1] else names[:1]

    @property
    def stem(self) -> float | None:
        """Outward direction of the stem of a T [rad]: the arm across the largest gap."""
        if "T" not in self.kinds:
            return None
        gaps = np.diff([*self.arms, self.arms[0] + 2 * np.pi])
        return self.arms[(int(gaps.argmax()) + 2) % 3]


def find_crossroads(
    lines: LaneLines, crossings: Crossings, partings: list[Parting], window: tuple[float, float, float, float]
) -> list[Crossroad]:
    """Junctions with three arms or more, the nearest to the origin first.

    Args:
      crossings: those at one level.
      window: least and largest x, least and largest y of the scene [m].
    """
    turns = [parting for parting in partings if parting.is_turn]
    points = np.concatenate([crossings.points, np.reshape([item.place for item in turns], (-1, 3))])
    if not len(points):
        return []
    members = np.zeros((len(points), len(lines)), bool)
    members[np.arange(len(crossings.lanes))[:, None], crossings.lanes] = True
    for row, parting in enumerate(turns, len(crossings.lanes)):
        members[row, list(parting.branches)] = True
    members &= np.abs(lines.turn) > _CONNECTOR_TURN
    labels = _cluster(points, members & (lines.length < _CONNECTOR_LENGTH))
    found = [
        _crossroad(lines, points[labels == label, :2], members[labels == label].any(0), window)
        for label in np.unique(labels)
    ]
    return sorted((item for item in found if len(item.arms) >= 3), key=lambda item: float(np.hypot(*item.center)))


def _cluster(points: np.ndarray, connectors: np.ndarray) -> np.ndarray:
    """Label of the junction of every point, its first point: neighbors are together, and points that a connector joins.

    The scenes of an untrained model have thousands of points, so no array holds all pairs: the search goes from point
    to point, and every point compares itself with those alone that nothing has reached yet.

    Args:
      points: [points, 3].
      connectors: [points, lanes], the short lanes that turn at a point.
    """
    labels, rest = np.full(len(points), -1), np.arange(len(points))
    while len(rest):
        first, rest = rest[0], rest[1:]
        labels[first] = first
        reached = [first]
        while reached and len(rest):
            point = reached.pop()
            offset = points[rest] - points[None, point]
            near = (np.hypot(offset[:, 0], offset[:, 1]) < _CLUSTER_DISTANCE) & (np.abs(offset[:, 2]) < MAX_LEVEL)
            if connectors[point].any():
                near |= (connectors[rest] & connectors[None, point]).any(1)
            reached.extend(rest[near])
            labels[rest[near]] = first
            rest = rest[~near]
    return labels


def _components(near: np.ndarray) -> np.ndarray:
    """Label of the connected component of every row of a symmetric matrix: its least index."""
    labels = np.arange(len(near))
    while True:
        lower = np.where(near, labels[None], len(near)).min(1)
        lower = np.minimum(lower, labels)
        lower = lower[lower]
        if (lower == labels).all():
            return labels
        labels = lower


def _crossroad(
    lines: LaneLines, points: np.ndarray, connectors: np.ndarray, window: tuple[float, float, float, float]
) -> Crossroad:
    """The junction at ``points``, which extends over the bends of its connectors [lanes]."""
    from scipy.spatial import KDTree

    headings, real = lines.headings[connectors], lines.real[connectors]
    from_start, to_end = (np.abs(wrap_to_pi(headings - headings[:, column, None])) for column in (0, -1))
    bent = real & (from_start > _STRAIGHT) & (to_end > _STRAIGHT)
    bends = lines.points[connectors][bent][:, :2]
    offset = bends - points[KDTree(points).query(bends)[1]]
    bends = bends[np.hypot(offset[:, 0], offset[:, 1]) < _MAX_EXTENT]
    extent = np.concatenate([points, bends])
    center = (extent.min(0) + extent.max(0)) / 2
    radius = float(np.hypot(*(extent - center).T).max())
    counts = [_arms(lines, center, radius + margin, window) for margin in _MARGINS]
    number, _ = Counter(len(arms) for arms in counts).most_common(1)[0]
    arms = next(arms for arms in counts if len(arms) == number)
    return Crossroad(center, points, radius, arms)


def _arms(
    lines: LaneLines, center: np.ndarray, radius: float, window: tuple[float, float, float, float]
) -> tuple[float, ...]:
    """Outward directions of the roads that leave a circle, or that the border cuts inside of it."""
    offset = lines.points[..., :2] - center
    inside = (np.hypot(offset[..., 0], offset[..., 1]) <= radius) & lines.real
    enters_lane, enters = np.nonzero(~inside[:, :-1] & inside[:, 1:])
    leaves_lane, leaves = np.nonzero(inside[:, :-1] & ~inside[:, 1:] & lines.real[:, 1:])
    lanes, last = np.arange(len(lines)), lines.count - 1
    low, high = np.array(window[::2]), np.array(window[1::2])
    starts = inside[:, 0] & _at_border(lines.points[:, 0, :2], low, high) & ~lines.follows.any(0)
    ends = inside[lanes, last] & _at_border(lines.points[lanes, last, :2], low, high) & ~lines.follows.any(1)
    lane = np.concatenate([enters_lane, lanes[starts], leaves_lane, lanes[ends]])
    point = np.concatenate([enters, np.zeros(starts.sum(), int), leaves, last[ends]])
    is_entry = np.arange(len(lane)) < len(enters_lane) + starts.sum()
    headings = lines.headings[lane, point] + np.pi * is_entry
    places = offset[lane, point]
    outward = np.cos(headings) * places[:, 0] + np.sin(headings) * places[:, 1] > -1.0
    low, high = np.maximum(point - _BEND_REACH, 0), np.minimum(point + _BEND_REACH, last[lane])
    bend = np.abs(wrap_to_pi(lines.headings[lane, high] - lines.headings[lane, low]))
    outward &= bend < _MAX_BEND * np.maximum(high - low - (low == 0) / 2 - (high == last[lane]) / 2, 1)
    return _group_arms(headings[outward], places[outward])


def _at_border(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.any(((points < low + _BORDER_DISTANCE) | (points > high - _BORDER_DISTANCE)), axis=-1)


def _group_arms(headings: np.ndarray, places: np.ndarray) -> tuple[float, ...]:
    """Directions of groups of lanes that leave side by side [rad], sorted in -pi..pi."""
    if not len(headings):
        return ()
    turn = np.abs(wrap_to_pi(headings[:, None] - headings[None]))
    mean = headings[:, None] + wrap_to_pi(headings[None] - headings[:, None]) / 2
    offset = places[None] - places[:, None]
    lateral = np.abs(np.cos(mean) * offset[..., 1] - np.sin(mean) * offset[..., 0])
    labels = _components((turn < _ARM_ANGLE) & (lateral < _ARM_WIDTH))
    vectors = np.stack([np.cos(headings), np.sin(headings)], -1)
    sums = [vectors[labels == label].sum(0) for label in np.unique(labels)]
    return tuple(sorted(float(np.arctan2(total[1], total[0])) for total in sums))
