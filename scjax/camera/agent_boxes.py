"""Boxes in space: corners, edges, faces, and what of them looks at a camera."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)])
"""Corners of the edges of a box: bottom, top, upright ones. Each is listed once."""

FRONT_CROSS = np.array([(0, 5), (1, 4)])
"""Diagonals of the front face, which show the heading."""

FACES = np.array([(0, 1, 5, 4), (2, 3, 7, 6), (1, 2, 6, 5), (3, 0, 4, 7), (4, 5, 6, 7), (3, 2, 1, 0)])
"""Corners of the faces front, rear, left, right, top, bottom; counter-clockwise as seen from outside."""

FRONT, REAR = 0, 1
EDGE_FACES = np.array([[(np.isin(edge, face)).all() for face in FACES] for edge in EDGES])
"""Which faces an edge belongs to [12, 6]."""

REAR_EDGES = EDGE_FACES[:, REAR]
_SIGNS = np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]])  # of x and y of corners 0..3; corners 4..7 lie above them


def box_corners_3d(
    centers: Float64[np.ndarray, "n 3"], headings: Float64[np.ndarray, " n"], sizes: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 8 3"]:
    """Corners of upright boxes [m]: below front right, front left, rear left, rear right; then above them."""
    cos, sin = np.cos(headings)[:, None], np.sin(headings)[:, None]
    x, y = (sizes[:, axis, None] / 2 * _SIGNS[:, axis] for axis in (0, 1))
    flat = np.stack([cos * x - sin * y, sin * x + cos * y], -1) + centers[:, None, :2]
    corners = np.empty((len(centers), 8, 3))
    corners[:, :4, :2] = corners[:, 4:, :2] = flat
    corners[:, :4, 2] = (centers[:, 2] - sizes[:, 2] / 2)[:, None]
    corners[:, 4:, 2] = (centers[:, 2] + sizes[:, 2] / 2)[:, None]
    return corners


def visible_faces(corners: Float64[np.ndarray, "n 8 3"]) -> Bool[np.ndarray, "n 6"]:
    """Which faces look at the origin, of corners in the frame of a camera. Faces without area do not."""
    faces = corners[:, FACES]
    return np.asarray(np.einsum("nfx,nfx->nf", face_normals(faces), faces[:, :, 0]) < 0)


def face_normals(quads: Float64[np.ndarray, "*n 4 3"]) -> Float64[np.ndarray, "*n 3"]:
    """Normals of flat faces, outwards; twice their area long."""
    (ax, ay, az), (bx, by, bz) = (
        np.moveaxis(quads[..., end, :] - quads[..., start, :], -1, 0) for start, end in ((0, 2), (1, 3))
    )
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def visible_edges(faces: Bool[np.ndarray, "n 6"]) -> Bool[np.ndarray, "n 12"]:
    """Which edges belong to a face that looks at the camera."""
    return np.asarray((faces[:, None] & EDGE_FACES).any(-1))
