"""Exact overlap of agent boxes; float64 on the host, without compilation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float64

_PARALLEL = 1e-9  # m; an edge that rises less over a side of a box is parallel to it
TOUCH = 1e-6  # m; rounding alone gives boxes that touch up to this penetration


def overlaps(agents: Float[np.ndarray, "agents 9"]) -> Bool[np.ndarray, "agents agents"]:
    """Pairs of boxes that share ground area; touching is not enough, and no box overlaps itself. Heights do not matter.

    Separating axis theorem: two convex shapes are disjoint exactly if a normal of one of their edges separates them.
    """
    depths, _ = _depths(np.asarray(agents, np.float64))
    return _are_deep(depths.min(-1))


def separations(agents: Float[np.ndarray, "agents 9"]) -> Float64[np.ndarray, "agents agents 2"]:
    """Shortest shift of box j after which it only touches box i [m]; zero where they do not overlap."""
    agents = np.asarray(agents, np.float64)
    depths, axes = _depths(agents)
    own = depths.argmin(-1)[..., None]
    depth = np.take_along_axis(depths, own, -1)
    offset = agents[None, :, :2] - agents[:, None, :2]
    along = np.take_along_axis(axes[:, None], own[..., None], 2)[:, :, 0]
    shift = depth * along * np.where((offset * along).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    of_other = depth > depth.swapaxes(0, 1)  # an edge of box j separates them at less
    shift = np.where(of_other, -shift.swapaxes(0, 1), shift)
    return np.where(_are_deep(depth[..., 0])[..., None], shift, 0.0)


def _are_deep(depth: np.ndarray) -> np.ndarray:
    """Pairs that overlap, by the least depth of each box in the other [agents, agents]."""
    overlap = np.minimum(depth, depth.T) > TOUCH
    np.fill_diagonal(overlap, False)
    return overlap


def _depths(agents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How deep box j reaches into box i along the axes of box i [i, j, 2 axes]; negative: not. And the axes."""
    ahead = agents[:, 4:6] / np.maximum(np.linalg.norm(agents[:, 4:6], axis=-1, keepdims=True), 1e-12)
    axes = np.stack([ahead, np.stack([-ahead[:, 1], ahead[:, 0]], -1)], 1)  # [agents, 2 axes, xy]
    half = agents[:, 6:8] / 2
    offset = agents[None, :, :2] - agents[:, None, :2]
    distance = np.abs(np.einsum("ijx,iax->ija", offset, axes))  # of the centers along the axes of box i
    cosines = np.abs(np.einsum("iax,jbx->ijab", axes, axes))
    reach = half[:, None, :] + np.einsum("ijab,jb->ija", cosines, half)
    return reach - distance, axes


def intersection_areas(
    first: Float[np.ndarray, "pairs 9"], second: Float[np.ndarray, "pairs 9"]
) -> Float64[np.ndarray, " pairs"]:
    """Ground area that box k of ``first`` shares with box k of ``second`` [m^2]; meant for boxes that ``overlaps``.

    The outline of the shared area consists of the parts of either outline inside the other box; Green's theorem sums
    it up edge by edge.
    """
    center = np.asarray(first, np.float64)[:, None, :2]
    first_corners, second_corners = corners(first) - center, corners(second) - center
    area = _outline_inside(first_corners, second_corners, shared=True)
    area = area + _outline_inside(second_corners, first_corners, shared=False)
    return np.maximum(area, 0.0)


def corners(boxes: Float[np.ndarray, "boxes 9"]) -> Float64[np.ndarray, "boxes 4 2"]:
    """Corners on the ground, counter-clockwise from the front left [m]."""
    boxes = np.asarray(boxes, np.float64)
    ahead = boxes[:, 4:6] / np.maximum(np.linalg.norm(boxes[:, 4:6], axis=-1, keepdims=True), 1e-12)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], -1)
    half = boxes[:, 6:8, None] / 2
    along, across = half[:, 0] * ahead, half[:, 1] * left
    signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    return boxes[:, None, :2] + np.stack([a * along + b * across for a, b in signs], 1)


def _outline_inside(edges: np.ndarray, hull: np.ndarray, *, shared: bool) -> np.ndarray:
    """Half the sum of cross(p, q) over the parts p q of each outline inside ``hull`` [pairs, 4, 2].

    Both outlines are counter-clockwise. Parts on the outline of the hull count only if ``shared``.
    """
    start, along = edges, np.roll(edges, -1, 1) - edges
    side = np.roll(hull, -1, 1) - hull
    inward = np.stack([-side[..., 1], side[..., 0]], -1) / np.maximum(np.linalg.norm(side, axis=-1), 1e-12)[..., None]
    depth = np.einsum("nehx,nhx->neh", start[:, :, None] - hull[:, None], inward)  # of the start, inside each side
    slope = np.einsum("nex,nhx->neh", along, inward)
    parallel = np.abs(slope) < _PARALLEL
    crossing = -depth / np.where(parallel, 1.0, slope)
    enter = np.where(~parallel & (slope > 0), crossing, 0.0).max(-1).clip(0, 1)
    leave = np.where(~parallel & (slope < 0), crossing, 1.0).min(-1).clip(0, 1)
    outside = parallel & ((depth < -_PARALLEL) if shared else (depth <= _PARALLEL))
    leave = np.where(outside.any(-1), enter, np.maximum(leave, enter))
    p, q = start + enter[..., None] * along, start + leave[..., None] * along
    return 0.5 * (p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]).sum(-1)
