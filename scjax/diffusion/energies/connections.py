"""Energy of open lane connections. Not in the paper."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from scjax.diffusion.energies.pseudo_huber import pseudo_huber
from scjax.scene import Link, Scene


def connection_energy(scene: Scene) -> Float[Array, " b"]:
    """Half the squared connection gap [m^2], summed over lane links [B].

    The gap is the xy distance from the end of a lane to the start of its successor; beyond 5 m the energy is linear.
    """
    lanes = jnp.asarray(scene.lanes)[..., :2]
    square = jnp.square(lanes[:, None, :, 0] - lanes[:, :, None, -1]).sum(-1)
    linked = (scene.links == Link.PREDECESSOR) & scene.lane_mask[:, :, None] & scene.lane_mask[:, None]
    return jnp.where(linked, pseudo_huber(square), 0).sum((1, 2))
