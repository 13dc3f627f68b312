"""The ground of a scene, inclined until the ego's road rises or falls as a request says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scjax.language.analysis.scene_analysis import analyze
from scjax.language.attributes.roads import AHEAD
from scjax.language.attributes.table import ATTRIBUTES
from scjax.scene import Scene

_SHORTEST = 5.0  # m of road ahead
_RISES = {"up": 0.9, "flat": 0.0, "down": -0.9}  # m over ``AHEAD``, where the scene shows another slope


def fit_slope(scene: Scene, request: Mapping[str, Any]) -> Scene:
    """Adds a plane to all heights: the ground keeps its shape, and what lies on it stays there.

    A scene that shows the requested slope, or whose ego is on no lane, stays as it is.

    Args:
      scene: one scene.
      request: in its normal form; "slope" alone counts.
    """
    if "slope" not in request:
        return scene
    analysis, attribute = analyze(scene), ATTRIBUTES["slope"]
    route = analysis.route
    if route is None or attribute.holds(request["slope"], attribute.measure(analysis)):
        return scene
    ahead = route.points_ahead(AHEAD)
    step = ahead[-1] - ahead[0]
    distance = float(np.hypot(*step[:2]))
    if distance < _SHORTEST:
        return scene
    gradient = (_RISES[request["slope"]] - float(step[2])) / distance * step[:2] / distance
    scene = scene.to_numpy()
    lanes, agents = np.array(scene.lanes), np.array(scene.agents)
    for values, mask in ((lanes, scene.lane_mask), (agents, scene.agent_mask)):
        values[mask, ..., 2] += (values[mask][..., :2] - route.pose(0.0)[:2]) @ gradient
    return scene.replace(lanes=lanes, agents=agents)
