"""Centerlines of one scene at steps of 1 m, and which of them follow each other."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.scene import Link, Scene
from scjax.scene.angles import wrap_to_pi

_STEP = 1.0  # m
_MIN_LENGTH = 1e-3  # m, shorter lanes are left out
_MAX_LISTED_GAP = 4.0  # m, a listed link with a wider gap is none
_MAX_GAP, _MAX_TURN, _MAX_RISE = 0.8, np.deg2rad(40.0), 1.5  # m, rad, m between ends that meet without a link


@dataclasses.dataclass(frozen=True)
class LaneLines:
    """Centerlines in driving direction. Points behind a lane's last one repeat it.

    Attributes:
      source: index of every lane in the scene.
      raw: points as the scene stores them [m].
      points: at most 1 m apart [m].
      headings: of the line at every point, over 2 m [rad].
      count: points of every lane.
      spacing: between points [m].
      length: in the plane [m].
      signals: ``Signal`` of every lane.
      follows: ``follows[i, j]``: lane j starts where lane i ends.
    """

    source: Int[np.ndarray, " lanes"]
    raw: Float64[np.ndarray, "lanes raw 3"]
    points: Float64[np.ndarray, "lanes points 3"]
    headings: Float64[np.ndarray, "lanes points"]
    count: Int[np.ndarray, " lanes"]
    spacing: Float64[np.ndarray, " lanes"]
    length: Float64[np.ndarray, " lanes"]
    signals: Int[np.ndarray, " lanes"]
    follows: Bool[np.ndarray, "lanes lanes"]

    def __len__(self) -> int:
        return len(self.points)

    @functools.cached_property
    def next(self) -> list[list[int]]:
        """Lanes after each lane."""
        return [np.flatnonzero(row).tolist() for row in self.follows]

    @functools.cached_property
    def previous(self) -> list[list[int]]:
        """Lanes before each lane."""
        return [np.flatnonzero(row).tolist() for row in self.follows.T]

    @functools.cached_property
    def bends(self) -> Float64[np.ndarray, "lanes steps"]:
        """Signed change of the heading from point to point [rad], positive to the left."""
        return wrap_to_pi(np.diff(self.headings, axis=1))

    @functools.cached_property
    def turn(self) -> Float64[np.ndarray, " lanes"]:
        """Signed turn over the whole lane [rad]."""
        return self.bends.sum(1)

    @functools.cached_property
    def real(self) -> Bool[np.ndarray, "lanes points"]:
        """False at points that repeat the last one."""
        return np.arange(self.points.shape[1]) < self.count[:, None]


def lane_lines(scene: Scene) -> LaneLines:
    """The lines of one unpadded NumPy scene."""
    raw = np.asarray(scene.lanes, np.float64)
    steps = np.hypot(*np.moveaxis(np.diff(raw[..., :2], axis=1), -1, 0))
    source = np.flatnonzero(steps.sum(1) > _MIN_LENGTH)
    raw, steps = raw[source], steps[source]
    length = steps.sum(1)
    count = np.maximum(2, np.ceil(length / _STEP).astype(int) + 1)
    spacing = length / (count - 1)
    most = int(count.max()) if len(count) else 2
    points = _resample_lanes(raw, steps, np.minimum(np.arange(most) * spacing[:, None], length[:, None]))
    last = count[:, None] - 1
    index = np.minimum(np.arange(most), last)
    rows = np.arange(len(raw))[:, None]
    chord = points[rows, np.minimum(index + 1, last), :2] - points[rows, np.maximum(index - 1, 0), :2]
    headings = np.arctan2(chord[..., 1], chord[..., 0])
    return LaneLines(
        source=source,
        raw=raw,
        points=points,
        headings=headings,
        count=count,
        spacing=spacing,
        length=length,
        signals=np.asarray(scene.signals)[source],
        follows=_follows(points, headings, np.asarray(scene.links)[np.ix_(source, source)]),
    )


def _resample_lanes(raw: np.ndarray, steps: np.ndarray, arc: np.ndarray) -> np.ndarray:
    """Points of every lane at the arc lengths ``arc`` [lanes, points]; one interpolation for all lanes."""
    if not len(raw):
        return np.zeros((0, arc.shape[1], 3))
    lengths = steps.sum(1) + 1.0
    offset = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])[:, None]
    known = offset + np.concatenate([np.zeros((len(raw), 1)), np.cumsum(steps, 1)], 1)
    flat = known.ravel(), (offset + arc).ravel()
    return np.stack([np.interp(flat[1], flat[0], raw[..., k].ravel()) for k in range(3)], -1).reshape(*arc.shape, 3)


def _follows(points: np.ndarray, headings: np.ndarray, links: np.ndarray) -> np.ndarray:
    """Listed links whose ends are near, and ends that meet without one [lanes, lanes]."""
    offset = points[None, :, 0] - points[:, None, -1]
    gap = np.hypot(offset[..., 0], offset[..., 1])
    turn = np.abs(wrap_to_pi(headings[None, :, 0] - headings[:, None, -1]))
    meets = (gap < _MAX_GAP) & (turn < _MAX_TURN) & (np.abs(offset[..., 2]) < _MAX_RISE)
    follows = ((links == Link.PREDECESSOR) & (gap < _MAX_LISTED_GAP)) | meets
    np.fill_diagonal(follows, False)
    return follows
