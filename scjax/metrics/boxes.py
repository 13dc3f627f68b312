"""Which agent boxes overlap, exactly, by the separating axis theorem; in float64 on the host, without compilation."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

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
