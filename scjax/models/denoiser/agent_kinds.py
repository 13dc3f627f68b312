"""Kinds of agents that the denoiser may be given: the classes of the codec, and large vehicles apart from others.

A scene then has as many vehicles, people, cyclists, static objects and large vehicles as were decided before.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from scjax.models.codec import SceneCodec
from scjax.scene import AgentType, Scene
from scjax.scene.scene import LARGE_LENGTH

NO_KIND = -1
"""Kind of an agent about which the network decides."""

_LENGTH = 6  # column of the agents


def num_kinds(codec: SceneCodec) -> int:
    """Number of kinds: the large vehicles are the last one."""
    return len(codec.agent_types) + 1


def agent_kinds(scene: Scene, codec: SceneCodec) -> Int[Array, "*b agents"]:
    """The kind of every agent of scenes in meters; ``NO_KIND`` at padding and for classes unknown to the codec."""
    kind_of = np.full(len(AgentType), NO_KIND, np.int32)
    kind_of[list(codec.agent_types)] = np.arange(len(codec.agent_types))
    types = jnp.asarray(scene.agent_types)
    is_large = (types == AgentType.VEHICLE) & (jnp.asarray(scene.agents)[..., _LENGTH] > LARGE_LENGTH)
    kinds = jnp.where(is_large, len(codec.agent_types), jnp.asarray(kind_of)[types])
    return jnp.where(scene.agent_mask, kinds, NO_KIND)
