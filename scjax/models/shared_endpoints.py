"""Connections by construction: all lane ends that links join become one point.

A decoder gives both sides of a connection an endpoint of their own, and both carry the error of their latents. Here all
ends of a node (the ends of lanes and the starts of their successors) move to their mean, and each lane follows smoothly
along its length. Gaps of linked ends are then zero, up to rounding, and what is left of the error is a bend.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from scjax.scene import AnyArray, Link, Scene

MAX_GAP = 5.0
"""Links over wider gaps [m] are taken for mistakes and removed, as by ``scene.repair``."""
_NEAR, _APART = 1.5, 2.0
"""Gap of a link that surely holds, and distance between ends that are surely two places [m]."""
_ROUNDS = 3  # removals of the widest link of a node that joins both ends of a lane


class _Nodes(NamedTuple):
    """Which lane ends are one node, [B, L, L] each; rows and columns are lanes.

    Attributes:
      end_end, end_start: nodes of the lanes' ends; start_start: of their starts.
    """

    end_end: Bool[Array, "b l l"]
    end_start: Bool[Array, "b l l"]
    start_start: Bool[Array, "b l l"]


def share_endpoints(scene: Scene, *, fixed: Bool[AnyArray, "b l"] | None = None, max_gap: float = MAX_GAP) -> Scene:
    """The scenes with one point for all ends of a node; differentiable, and independent of padding.

    Removed are links over gaps wider than ``max_gap``, those that would draw two places together, and the widest links
    of a node that would bring both ends of a lane to one place; if that does not help, all links of the node. Links
    between fixed lanes stay.

    Args:
      scene: batch [B] in meters with consistent links.
      fixed: True at lanes that do not move [B, L]; their ends decide where the node lies. None: none.
      max_gap: [m].
    """
    mask = jnp.asarray(scene.lane_mask)
    lanes = jnp.where(mask[..., None, None], scene.lanes, 0)
    fixed = jnp.zeros(mask.shape, bool) if fixed is None else jnp.asarray(fixed) & mask
    joined = (jnp.asarray(scene.links) == Link.PREDECESSOR) & mask[:, :, None] & mask[:, None]
    offset = jax.lax.stop_gradient(lanes[:, None, :, 0, :2] - lanes[:, :, None, -1, :2])
    gap = jnp.sqrt(jnp.square(offset).sum(-1))
    stays = fixed[:, :, None] & fixed[:, None]
    linked = joined & ((gap <= max_gap) | stays)
    to_start = _one_too_many(linked, gap, lanes[:, :, 0])
    to_end = _one_too_many(linked.swapaxes(1, 2), gap.swapaxes(1, 2), lanes[:, :, -1]).swapaxes(1, 2)
    linked = linked & (stays | ~(to_start | to_end))
    for _ in range(_ROUNDS):
        width = jnp.where(_folding(linked) & ~stays, gap, -1)
        widest = jnp.where(_nodes(linked).end_end, width.max(-1)[:, None], -1).max(-1)
        linked = linked & ~((width >= 0) & (width == widest[:, :, None]))
    linked = linked & ~(_folding(linked) & ~stays)
    nodes = _nodes(linked)
    ends, starts = _node_positions(nodes, lanes[:, :, -1], lanes[:, :, 0], fixed)
    moved = jnp.where((mask & ~fixed)[..., None, None], _spread(lanes, starts, ends), lanes)
    removed = joined & ~linked
    removed = removed | removed.swapaxes(1, 2)
    return scene.replace(lanes=moved, links=jnp.where(removed, Link.NONE, jnp.asarray(scene.links)).astype(jnp.int32))


def _one_too_many(
    linked: Bool[Array, "b l l"], gap: Float[Array, "b l l"], starts: Float[Array, "b l 3"]
) -> Bool[Array, "b l l"]:
    """Links of a lane to another place than its nearest link, to lanes that others lead to."""
    nearest = jnp.where(linked, gap, jnp.inf).argmin(2)  # follower of each lane
    offset = starts[:, None, :, :2] - jnp.take_along_axis(starts, nearest[..., None], 1)[:, :, None, :2]
    near = linked & (gap <= _NEAR)
    others = near.sum(1)[:, None] - near
    return linked & (jnp.square(offset).sum(-1) > _APART**2) & (others > 0)


def _spread(
    lanes: Float[Array, "b l p 3"], starts: Float[Array, "b l 3"], ends: Float[Array, "b l 3"]
) -> Float[Array, "b l p 3"]:
    """The lanes with new first and last points; between them the share of a move falls as a cubic, level at both."""
    s = jnp.linspace(0, 1, lanes.shape[2], dtype=lanes.dtype)[None, None, :, None]
    share = s * s * (3 - 2 * s)
    moved = lanes + (1 - share) * (starts - lanes[:, :, 0])[:, :, None] + share * (ends - lanes[:, :, -1])[:, :, None]
    # Set, since lane + (node - lane) would round differently in each lane of a node.
    return moved.at[:, :, 0].set(starts).at[:, :, -1].set(ends)


def _nodes(linked: Bool[Array, "b l l"]) -> _Nodes:
    """Ends of lanes (rows of ``linked``) and starts (columns) that links connect, also by way of others."""
    ends = _times(linked, linked.swapaxes(1, 2)) | jnp.eye(linked.shape[1], dtype=bool)[None]
    for _ in range(math.ceil(math.log2(max(linked.shape[1], 2)))):
        ends = _times(ends, ends)
    end_start = _times(ends, linked)
    own = jnp.eye(linked.shape[1], dtype=bool)[None]
    return _Nodes(ends, end_start, _times(end_start.swapaxes(1, 2), linked) | own)


def _times(a: Bool[Array, "b l m"], b: Bool[Array, "b m n"]) -> Bool[Array, "b l n"]:
    return jnp.einsum("blm,bmn->bln", a.astype(jnp.float32), b.astype(jnp.float32)) > 0


def _folding(linked: Bool[Array, "b l l"]) -> Bool[Array, "b l l"]:
    """The links of nodes that hold both ends of a lane."""
    nodes = _nodes(linked)
    folded = jnp.diagonal(nodes.end_start, axis1=1, axis2=2)
    return (nodes.end_end & folded[:, None]).any(-1)[:, :, None] & linked


def _node_positions(
    nodes: _Nodes, ends: Float[Array, "b l 3"], starts: Float[Array, "b l 3"], fixed: Bool[Array, "b l"]
) -> tuple[Float[Array, "b l 3"], Float[Array, "b l 3"]]:
    """Where the ends and the starts of all lanes go: the mean of their node, or of the fixed ones in it."""
    top = jnp.concatenate([nodes.end_end, nodes.end_start], 2)
    bottom = jnp.concatenate([nodes.end_start.swapaxes(1, 2), nodes.start_start], 2)
    same, points = jnp.concatenate([top, bottom], 1), jnp.concatenate([ends, starts], 1)
    count = ends.shape[1]
    both = jnp.concatenate([fixed, fixed], 1)
    counted = jnp.where((same & both[:, None]).any(-1)[..., None], same & both[:, None], same).astype(points.dtype)
    mean = jnp.einsum("bnm,bmd->bnd", counted, points) / counted.sum(-1, keepdims=True)
    first = same.argmax(-1)[..., None]  # all members of a node take the sum of one row: equal bit for bit
    mean = jnp.take_along_axis(mean, first, 1)
    return mean[:, :count], mean[:, count:]
