"""Ends of lanes inside the window that lead nowhere."""

from __future__ import annotations

import numpy as np

from scjax.scene import TILE_SIZE, Crop, Link, Scene
from scjax.scene.angles import wrap_to_pi

_BORDER = 4.0  # m from the border, where the window cuts lanes
_MEETS = 0.8  # m between ends that meet without a link
_WAY_BACK = 9.0  # m between an end and the lane that leads back from it
_TURNS_BACK = np.deg2rad(130.0)


def count_loose_ends(scene: Scene) -> int:
    """Starts and ends of lanes without a link, 4 m or more inside the window; those of dead ends do not count.

    At a dead end a lane of the other direction begins beside the one that ends.

    Args:
      scene: one scene.
    """
    scene = scene.to_numpy()
    mask = np.asarray(scene.lane_mask)
    lanes, links = np.asarray(scene.lanes, np.float64)[mask], np.asarray(scene.links)[np.ix_(mask, mask)]
    if not len(lanes):
        return 0
    starts, ends = lanes[:, 0, :2], lanes[:, -1, :2]
    leaving, coming = _headings(lanes[:, -2:]), _headings(lanes[:, :2])
    follows = (links == Link.PREDECESSOR) | (_distances(ends, starts) < _MEETS)
    np.fill_diagonal(follows, False)
    free_end, free_start = ~follows.any(1), ~follows.any(0)
    back = (_distances(ends, starts) < _WAY_BACK) & free_end[:, None] & free_start[None]
    back &= np.abs(wrap_to_pi(leaving[:, None] - coming[None])) > _TURNS_BACK
    np.fill_diagonal(back, False)
    middle = np.array([TILE_SIZE / 2 if int(scene.crop) == Crop.FORWARD else 0.0, 0.0])
    loose_ends = free_end & ~back.any(1) & _are_inside(ends - middle)
    loose_starts = free_start & ~back.any(0) & _are_inside(starts - middle)
    return int(loose_ends.sum() + loose_starts.sum())


def _headings(points: np.ndarray) -> np.ndarray:
    """Directions from the first to the last of each lane's points [rad]."""
    step = points[:, -1, :2] - points[:, 0, :2]
    return np.arctan2(step[:, 1], step[:, 0])


def _distances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    offset = one[:, None] - other[None]
    return np.hypot(offset[..., 0], offset[..., 1])


def _are_inside(offsets: np.ndarray) -> np.ndarray:
    return np.abs(offsets).max(-1) < TILE_SIZE / 2 - _BORDER
