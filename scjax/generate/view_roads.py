"""Where windows have lanes, in coarse bins of the space that a picture shows, and how far lanes that are seen fit that.

The bins of a window are a part of its outline (``ViewOutlines.roads``): so the outline whose lanes lie most like those
that are seen can be drawn, though outlines hold no coordinates.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from scjax.generate.seen_lanes import SeenLanes, lane_errors
from scjax.models.denoiser.kinds import SECTORS
from scjax.scene import Scene

_SIDE = 2.0  # m of a square of ground
_LENGTH, _HALF_WIDTH = 44.0, 22.0  # m, of all squares
_OPENING, _BESIDE = 0.62, 1.0  # half of the view's width by the distance ahead, and m more
_PARTS = 4  # of a segment of a lane, to fall into every square
_ALIKE = np.cos(np.deg2rad(36.0))  # a sector is 22.5 degrees to each side
_SLACK = 1.0  # m that the middle of a square may be off
_ALONG, _ALONG_SHARE = 2.0, 0.1  # m, and share of the distance: lanes go on so far before and behind a seen point
_FALSE = 0.5  # weight of lanes where none is seen
_AT_ONCE = 2000  # windows


def _squares() -> Float64[np.ndarray, "squares 2"]:
    """Middles of the squares of ground in view [m]."""
    ahead = np.arange(_SIDE / 2, _LENGTH, _SIDE)
    aside = np.arange(_SIDE / 2 - _HALF_WIDTH, _HALF_WIDTH, _SIDE)
    grid = np.stack(np.meshgrid(ahead, aside, indexing="ij"), -1).reshape(-1, 2)
    return grid[np.abs(grid[:, 1]) < _OPENING * grid[:, 0] + _BESIDE]


SQUARES = _squares()
"""Middles of the squares [m], x ahead and y to the left; each has ``SECTORS`` bins."""

BINS = len(SQUARES) * SECTORS
BYTES = -(-BINS // 8)
"""Of the packed bins of a window."""


def lane_bins(scene: Scene) -> UInt8[np.ndarray, " bytes"]:
    """Which bins, a square and a direction each, a lane of a forward window goes through; packed bits."""
    lanes = np.asarray(scene.lanes, np.float64)[np.asarray(scene.lane_mask), :, :2]
    steps = lanes[:, 1:] - lanes[:, :-1]
    shares = (np.arange(_PARTS) + 0.5) / _PARTS
    points = (lanes[:, :-1, None] + shares[:, None] * steps[:, :, None]).reshape(-1, 2)
    angles = np.repeat(np.arctan2(steps[..., 1], steps[..., 0]).ravel(), _PARTS)
    sectors = np.round(angles * SECTORS / (2 * np.pi)).astype(int) % SECTORS
    corner = np.floor(SQUARES / _SIDE).astype(int)
    rows = {tuple(square): row for row, square in enumerate(corner.tolist())}
    bins = np.zeros((len(SQUARES), SECTORS), bool)
    for square, sector in zip(np.floor(points / _SIDE).astype(int).tolist(), sectors.tolist(), strict=True):
        row = rows.get(tuple(square))
        if row is not None:
            bins[row, sector] = True
    return np.packbits(bins.ravel())


def misfits(roads: UInt8[np.ndarray, "windows bytes"], seen: SeenLanes) -> Float64[np.ndarray, " windows"]:
    """How badly the lanes of each window fit lanes that are seen, from 0 to 1.5.

    The mean over the points that are seen of a bounded cost of the distance to the nearest bin of the window, and half
    the mean over the bins of the window of that to the nearest point that is seen.
    """
    cover, false = _costs(seen)
    result = np.empty(len(roads))
    for start in range(0, len(roads), _AT_ONCE):
        bins = np.unpackbits(roads[start : start + _AT_ONCE], axis=1, count=BINS)
        found = np.zeros(len(bins))
        for gains in 1 - cover:
            near = np.flatnonzero(gains > 0)
            found += (bins[:, near] * gains[near]).max(1, initial=0.0)
        wrong = bins @ false / np.maximum(bins.sum(1, dtype=np.int32), 1)
        result[start : start + _AT_ONCE] = 1 - found / len(cover) + _FALSE * wrong
    return result


def _costs(seen: SeenLanes) -> tuple[Float32[np.ndarray, "points bins"], Float32[np.ndarray, " bins"]]:
    """Costs of each bin for each point, 1 where it is far or heads elsewhere; and of each bin for the nearest point."""
    angles = 2 * np.pi / SECTORS * np.arange(SECTORS)
    alike: Bool[np.ndarray, "points sectors"] = seen.headings @ np.stack([np.cos(angles), np.sin(angles)]) > _ALIKE
    offsets = SQUARES - seen.points[:, None]
    gaps = np.maximum(np.linalg.norm(offsets, axis=-1) - _SLACK, 0.0) / lane_errors(seen)[:, None]
    cover = _of_bins(gaps, alike)
    across = offsets[..., 1] * seen.headings[:, None, 0] - offsets[..., 0] * seen.headings[:, None, 1]
    along = (
        np.abs((offsets * seen.headings[:, None]).sum(-1)) - _ALONG - _ALONG_SHARE * np.hypot(*seen.points.T)[:, None]
    )
    gaps = np.hypot(np.maximum(np.abs(across) - _SLACK, 0.0), np.maximum(along, 0.0)) / lane_errors(seen)[:, None]
    return cover, _of_bins(gaps, alike).min(0)


def _of_bins(
    gaps: Float64[np.ndarray, "points squares"], alike: Bool[np.ndarray, "points sectors"]
) -> Float32[np.ndarray, "points bins"]:
    """1 - 1 / (1 + gap^2) for bins of the directions that are alike, else 1; far ones are exactly 1."""
    gains = 1 / (1 + gaps**2)
    gains = np.where(gains > 0.05, gains, 0.0)[:, :, None] * alike[:, None]
    return (1 - gains).reshape(len(gaps), -1).astype(np.float32)
