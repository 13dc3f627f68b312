"""What the parts of a scene owe each other, as penalties of an estimate of x_0: linked lanes meet, agents keep their
offset from the lane beside them.

The mean squared error of latents hardly sees either. A few decimetres decide whether a road is whole or a car in its
lane, while the error of one latent number moves a lane by metres, and both ends of a joint may well move alike. In
metres, against the scene that was noised, whose own joints need not be closed. Not in the paper.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.diffusion.noise_level import NoiseLevel
from scjax.scene import AnyArray, Link, Scene

BESIDE = 3.0
"""An agent is held to the nearest point of a lane if that is no farther away [m]."""
_CORNER = 0.05  # m; smaller errors count by their square, so that gradients stay finite
_NOWHERE = 1e6  # m, where lanes lie that are padding


def connection_error(generated: Scene, scene: Scene) -> Float[Array, " b"]:
    """Mean over links of how wrong the step is from the end of a lane to the start of the next, in xy [m]."""
    found, wanted = (s.lanes[:, None, :, 0, :2] - s.lanes[:, :, None, -1, :2] for s in (generated, scene))
    linked = (scene.links == Link.PREDECESSOR) & scene.lane_mask[:, :, None] & scene.lane_mask[:, None]
    error = _length(jnp.square(jnp.asarray(found - wanted)).sum(-1))
    return jnp.where(linked, error, 0).sum((1, 2)) / jnp.maximum(linked.sum((1, 2)), 1)


def offset_error(generated: Scene, scene: Scene) -> Float[Array, " b"]:
    """Mean over agents of how wrong their offset is from the nearest point of a lane, across that lane [m].

    The point and its direction are those of ``scene``. Agents farther than ``BESIDE`` from every lane do not count.
    """
    lines, scenes = jnp.asarray(scene.lanes)[..., :2], len(scene.lanes)
    ahead = jnp.diff(lines, axis=2)
    along = jnp.concatenate([ahead, ahead[:, :, -1:]], 2).reshape(scenes, -1, 2)
    points = jnp.where(scene.lane_mask[..., None, None], lines, _NOWHERE).reshape(scenes, -1, 2)
    shifts = jnp.asarray(generated.lanes - scene.lanes)[..., :2].reshape(scenes, -1, 2)
    apart = jnp.square(scene.agents[:, :, None, :2] - points[:, None]).sum(-1)
    nearest = apart.argmin(-1)[..., None]
    direction, shift = (jnp.take_along_axis(x, nearest, 1) for x in (along, shifts))
    error = (generated.agents - scene.agents)[..., :2] - shift
    across = jnp.square(direction[..., 0] * error[..., 1] - direction[..., 1] * error[..., 0])
    across = _length(across / jnp.maximum(jnp.square(direction).sum(-1), 1e-6))
    counted = scene.agent_mask & (apart.min(-1) < BESIDE**2)
    return jnp.where(counted, across, 0).sum(1) / jnp.maximum(counted.sum(1), 1)


def estimate_weight(level: NoiseLevel) -> Float[Array, " b"]:
    """(1 - 2 noise) / noise where that is positive, the noise at least 0.1.

    Errors of an estimate of x_0 shrink with the noise. Where there is much of it the estimate is a mean of many scenes,
    and no scene whose joints should be closed; doing so went with fewer prompts met (experiments/results/shipped).
    """
    noise = jnp.asarray(level.noise)
    return jax.nn.relu(1 - 2 * noise) / jnp.maximum(noise, 0.1)


def _length(square: Float[AnyArray, "*shape"]) -> Float[Array, "*shape"]:
    return jnp.sqrt(square + _CORNER**2) - _CORNER
