"""Input features of nearby geometry: soft offsets to nearby lane endpoints, lanes and agents.

Whether two lanes connect, or a car is on its lane, depends on decimeters between two tokens. Attention would have to
find them in products of hidden numbers. The mean shift toward nearby points (Comaniciu & Meer 2002), at several
scales, is linear in the needed correction. The points come from the noisy latents (``PositionHead``). Not in the
release.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.models.denoiser.position_head import POINTS, UNIT
from scjax.nn.cpu.precision import Compute
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear
from scjax.scene.per_type import PerType

# (own, other) point of two lanes: successors, predecessors, splits, merges, parallel neighbors.
_PAIRED = ((-1, 0), (0, -1), (0, 0), (-1, -1), (POINTS.lanes // 2, POINTS.lanes // 2))
_SCALES = {"lanes": (1.0, 3.0, 9.0), "agents": (2.0, 4.0, 8.0), "on lane": (1.0, 2.0, 4.0)}  # meters
_NUMBERS = PerType(  # shift and weight; for agents on lanes also the lane's direction
    agents=3 * len(_SCALES["agents"]) + 5 * len(_SCALES["on lane"]), lanes=3 * len(_PAIRED) * len(_SCALES["lanes"])
)
_MIN_WEIGHT = 0.1  # a neighbor at distance zero weighs 1; shifts fade for total weights below this
_MIN_LENGTH = 0.1  # m; directions of shorter segments fade


class RelativeGeometry(nnx.Module):
    """Points of tokens -> additions to their embeddings: exactly zero in a fresh network."""

    def __init__(self, width: PerType, *, init: ParamInit, compute: Compute = "float32"):
        self.agents = Linear(_NUMBERS.agents, width.agents, init=init, compute=compute, std=0.0)
        self.lanes = Linear(_NUMBERS.lanes, width.lanes, init=init, compute=compute, std=0.0)

    def __call__(self, points: PerType, masks: PerType) -> PerType:
        """Points [B, tokens, points, 2] per type (finite at padding, too) and masks -> [B, tokens, width] per type."""
        agents, lanes = UNIT * points.agents, UNIT * points.lanes
        return PerType(
            agents=self.agents(agent_geometry(agents, lanes, masks)),
            lanes=self.lanes(lane_geometry(lanes, masks.lanes)),
        )


def lane_geometry(lanes: Float[Array, "b n p 2"], mask: Bool[Array, "b n"]) -> Float[Array, "b n f"]:
    """Shifts from points of every lane toward points of other lanes, in the window's axes and in units of a scale."""
    others = mask[:, None] & ~jnp.eye(mask.shape[1], dtype=bool)[None]
    features = []
    for own, other in _PAIRED:
        offset = lanes[:, None, :, other] - lanes[:, :, None, own]
        features += [_shift(offset, _proximity(offset, others, scale), scale) for scale in _SCALES["lanes"]]
    return jnp.concatenate(features, -1)


def agent_geometry(
    agents: Float[Array, "b n p 2"], lanes: Float[Array, "b m r 2"], masks: PerType
) -> Float[Array, "b n f"]:
    """Shifts from every agent toward other agents and the nearest points of lanes, with the lanes' directions."""
    others = masks.agents[:, None] & ~jnp.eye(masks.agents.shape[1], dtype=bool)[None]
    center = agents[:, :, 0]
    offset = center[:, None] - center[:, :, None]
    features = [_shift(offset, _proximity(offset, others, scale), scale) for scale in _SCALES["agents"]]

    start, along = (x.reshape(len(lanes), 1, -1, 2) for x in (lanes[:, :, :-1], lanes[:, :, 1:] - lanes[:, :, :-1]))
    from_start = center[:, :, None] - start
    square = jnp.square(along).sum(-1) + _MIN_LENGTH**2
    foot = jnp.clip((from_start * along).sum(-1) / square, 0, 1)[..., None] * along
    offset = foot - from_start
    direction = jnp.broadcast_to(along * jax.lax.rsqrt(square)[..., None], offset.shape)
    segments = jnp.repeat(masks.lanes, lanes.shape[2] - 1, -1)[:, None]
    for scale in _SCALES["on lane"]:
        proximity = _proximity(offset, segments, scale)
        features += [_shift(offset, proximity, scale), _mean(direction, proximity)]
    return jnp.concatenate(features, -1)


def _proximity(offset: Float[Array, "b n m 2"], mask: Bool[Array, "b n_or_1 m"], scale: float) -> Float[Array, "b n m"]:
    """Gaussian of the distance with standard deviation ``scale`` [m], 1 at distance zero; 0 where masked."""
    return jnp.where(mask, jnp.exp(-0.5 * jnp.square(offset / scale).sum(-1)), 0.0)


def _shift(offset: Float[Array, "b n m 2"], proximity: Float[Array, "b n m"], scale: float) -> Float[Array, "b n 3"]:
    total = proximity.sum(-1, keepdims=True)
    return jnp.concatenate([_mean(offset / scale, proximity), total / (1 + total)], -1)


def _mean(values: Float[Array, "b n m 2"], proximity: Float[Array, "b n m"]) -> Float[Array, "b n 2"]:
    return (proximity[..., None] * values).sum(2) / (proximity.sum(-1, keepdims=True) + _MIN_WEIGHT)
