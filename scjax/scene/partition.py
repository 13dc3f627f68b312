"""The known half of partitioned scenes."""

from __future__ import annotations

import jax.numpy as jnp

from scjax.scene.per_type import PerType
from scjax.scene.scene import Crop, Scene


def elements_behind(scene: Scene) -> PerType:
    """Elements in the known half (x <= 0) of partitioned scenes, True or False [..., tokens] per type.

    The 10th of 20 points decides for a lane. In other crops no element is behind.
    """
    partitioned = (jnp.asarray(scene.crop) == Crop.PARTITIONED)[..., None]
    middle = scene.lanes.shape[-2] // 2 - 1
    return PerType(
        agents=partitioned & scene.agent_mask & (scene.agents[..., 0] <= 0),
        lanes=partitioned & scene.lane_mask & (scene.lanes[..., middle, 0] <= 0),
    )
