"""Training losses on relations between parts of a scene: lane connections, and lateral offsets of agents from lanes.

The mean squared error of latents hardly measures either. Decimeters decide whether a road is connected or a car is in
its lane, but the error of one latent moves a lane by meters, and both ends of a connection may move alike. These losses
compare the decoded x0 estimate with the recorded scene in meters. Gaps that the recording has are no error. Not in the
paper.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.diffusion.noise_level import NoiseLevel
from scjax.scene import AnyArray, Link, Scene

MAX_LANE_DISTANCE = 3.0
"""Agents farther than this [m] from every lane have no lateral offset."""
_SMOOTH_BELOW = 0.05  # m; smaller errors are quadratic, so that gradients stay finite
_PADDING_POSITION = 1e6  # m; far from everything


def connection_error(generated: Scene, scene: Scene) -> Float[Array, " b"]:
    """Mean error [m] of the xy offset from a lane's end to its successor's start, over lane links [B].

    Args:
      generated: decoded estimates.
      scene: recorded scenes, which define links and masks.
    """
    offset, expected = (s.lanes[:, None, :, 0, :2] - s.lanes[:, :, None, -1, :2] for s in (generated, scene))
    linked = (scene.links == Link.PREDECESSOR) & scene.lane_mask[:, :, None] & scene.lane_mask[:, None]
    error = _smooth_norm(jnp.square(jnp.asarray(offset - expected)).sum(-1))
    return jnp.where(linked, error, 0).sum((1, 2)) / jnp.maximum(linked.sum((1, 2)), 1)


def lateral_offset_error(generated: Scene, scene: Scene) -> Float[Array, " b"]:
    """Mean error [m] of the agents' offset from their nearest lane point, across the lane, over agents [B].

    Args:
      generated: decoded estimates.
      scene: recorded scenes, which define the nearest points, lane directions and masks. Agents farther than
        ``MAX_LANE_DISTANCE`` from every lane do not count.
    """
    lines, scenes = jnp.asarray(scene.lanes)[..., :2], len(scene.lanes)
    segments = jnp.diff(lines, axis=2)
    directions = jnp.concatenate([segments, segments[:, :, -1:]], 2).reshape(scenes, -1, 2)
    points = jnp.where(scene.lane_mask[..., None, None], lines, _PADDING_POSITION).reshape(scenes, -1, 2)
    shifts = jnp.asarray(generated.lanes - scene.lanes)[..., :2].reshape(scenes, -1, 2)
    square_distance = jnp.square(scene.agents[:, :, None, :2] - points[:, None]).sum(-1)
    nearest = square_distance.argmin(-1)[..., None]
    direction, shift = (jnp.take_along_axis(x, nearest, 1) for x in (directions, shifts))
    error = (generated.agents - scene.agents)[..., :2] - shift
    lateral = jnp.square(direction[..., 0] * error[..., 1] - direction[..., 1] * error[..., 0])
    lateral = _smooth_norm(lateral / jnp.maximum(jnp.square(direction).sum(-1), 1e-6))
    counted = scene.agent_mask & (square_distance.min(-1) < MAX_LANE_DISTANCE**2)
    return jnp.where(counted, lateral, 0).sum(1) / jnp.maximum(counted.sum(1), 1)


def relation_weight(level: NoiseLevel) -> Float[Array, " b"]:
    """Weight of the relation losses [B]: (1 - 2 sigma) / sigma with sigma at least 0.1; 0 above sigma 0.5.

    Errors of the x0 estimate shrink with the noise. At high noise the estimate is a mean of many scenes, whose
    connections need not be closed; weights there lowered the prompt adherence.
    """
    sigma = jnp.asarray(level.sigma)
    return jax.nn.relu(1 - 2 * sigma) / jnp.maximum(sigma, 0.1)


def _smooth_norm(square: Float[AnyArray, "*shape"]) -> Float[Array, "*shape"]:
    return jnp.sqrt(square + _SMOOTH_BELOW**2) - _SMOOTH_BELOW
