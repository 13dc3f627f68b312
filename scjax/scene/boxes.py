"""Which agent boxes overlap, and by how much, exactly; in float64 on the host, without compilation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float64

_LEVEL = 1e-9  # metres by which an edge must rise over a wall to count as crossing it
TOUCH = 1e-6  # metres of penetration that rounding alone can make of two boxes that touch


def overlaps(agents: Float[np.ndarray, "agents 9"]) -> Bool[np.ndarray, "agents agents"]:
    """Pairs of boxes that share ground area; touching is not enough, and no box overlaps itself. Heights play no part.

    Two convex shapes are apart exactly if one of their edge normals parts them; boxes have two each.
    """
    agents = np.asarray(agents, np.float64)
    ahead = agents[:, 4:6] / np.maximum(np.linalg.norm(agents[:, 4:6], axis=-1, keepdims=True), 1e-12)
    axes = np.stack([ahead, np.stack([-ahead[:, 1], ahead[:, 0]], -1)], 1)  # [agents, 2 axes, xy]
    half = agents[:, 6:8] / 2
    apart = agents[None, :, :2] - agents[:, None, :2]
    centre = np.abs(np.einsum("ijx,iax->ija", apart, axes))  # distance of the centres along the axes of box i
    cosines = np.abs(np.einsum("iax,jbx->ijab", axes, axes))
    reach = half[:, None, :] + np.einsum("ijab,jb->ija", cosines, half)
    depth = (reach - centre).min(-1)
    found = np.minimum(depth, depth.T) > TOUCH
    np.fill_diagonal(found, False)
    return found


def intersection_areas(
    first: Float[np.ndarray, "pairs 9"], second: Float[np.ndarray, "pairs 9"]
) -> Float64[np.ndarray, " pairs"]:
    """Ground area that box k of ``first`` shares with box k of ``second`` [m^2]; meant for boxes that ``overlaps``.

    The outline of the shared area consists of the parts of either outline inside the other box; Green's theorem sums
    it up edge by edge.
    """
    middle = np.asarray(first, np.float64)[:, None, :2]
    one, two = corners(first) - middle, corners(second) - middle
    return np.maximum(_outline_inside(one, two, shared=True) + _outline_inside(two, one, shared=False), 0.0)


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
    """Half the sum of cross(p, q) over the parts p q of each outline inside ``hull`` [pairs, 4, 2], counter-clockwise.

    Parts on the hull's own outline count where ``shared``.
    """
    start, along = edges, np.roll(edges, -1, 1) - edges
    wall = np.roll(hull, -1, 1) - hull
    inward = np.stack([-wall[..., 1], wall[..., 0]], -1) / np.maximum(np.linalg.norm(wall, axis=-1), 1e-12)[..., None]
    depth = np.einsum("nehx,nhx->neh", start[:, :, None] - hull[:, None], inward)  # of the start, behind each wall
    slope = np.einsum("nex,nhx->neh", along, inward)
    level = np.abs(slope) < _LEVEL
    at = -depth / np.where(level, 1.0, slope)
    enter = np.where(~level & (slope > 0), at, 0.0).max(-1).clip(0, 1)
    leave = np.where(~level & (slope < 0), at, 1.0).min(-1).clip(0, 1)
    outside = level & ((depth < -_LEVEL) if shared else (depth <= _LEVEL))
    leave = np.where(outside.any(-1), enter, np.maximum(leave, enter))
    p, q = start + enter[..., None] * along, start + leave[..., None] * along
    return 0.5 * (p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]).sum(-1)
