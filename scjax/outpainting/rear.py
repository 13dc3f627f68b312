"""``scjax.complete_rear``: what lies behind the ego of a forward scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Array

from scjax.generate.conditions import Condition
from scjax.outpainting.coverage import Coverage, OpenEnd
from scjax.outpainting.extend import extend_map
from scjax.scene import Crop, Map, Scene, scene_to_map
from scjax.scene.edit import single_scene

_REACH = 16.0  # m beside the ego, where a lane leads back
_AT_EDGE = 1.0  # m


def complete_rear(key: Array | int, scene: Scene, condition: Condition | str | None = None, **options: Any) -> Map:
    """A forward scene, such as of a camera's view, with the 32 m behind its ego.

    The tile behind is one of ``extend_map`` that looks back. The network knows windows whose ego drives on, so the
    tile is put where the nearest lane leads back; on one-way roads there is none, and fewer tiles become complete.

    Args:
      key: typed key, or its number.
      scene: a single scene with crop ``Crop.FORWARD``; all of it stays.
      condition: what is to be behind, as in ``extend_map``.
      options: further ones of ``extend_map``: candidates, retries, model, num_steps, repair.

    Returns:
      A map in the frame of the scene: tile 0 is the scene, tile 1 what is behind. ``crop_map(map, 0.0, 0.0)`` is the
      centered scene, ``crop_map(map, agent="0.agent-0")`` that with the ego.

    Raises:
      ValueError: the scene is no forward scene or has no lanes, or as ``extend_map``.
    """
    scene = single_scene(scene)
    if scene.crop != Crop.FORWARD:
        raise ValueError("scene is not cut forward (Scene.crop): a centered scene already shows what is behind its ego")
    map = scene_to_map(scene)
    back = lanes_back(map)
    y = min((float(end.place[1]) for end in back), key=abs, default=0.0)
    return extend_map(key, map, condition, x=0.0, y=y, yaw=np.pi, ego=bool(back), **options)


def lanes_back(map: Map) -> list[OpenEnd]:
    """The ends of lanes that lead out of a forward scene behind its ego, at most 16 m beside it."""
    return [
        end
        for end in Coverage(map).open_ends(map)
        if not end.is_start
        and abs(end.place[0]) < _AT_EDGE
        and abs(end.place[1]) < _REACH
        and np.cos(end.outward) < -0.5
    ]
