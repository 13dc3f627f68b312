"""One step of a log around one object -> the ``Scene`` that networks read."""

from __future__ import annotations

import numpy as np

from scjax.data.crop import crop_scene
from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.local_map import cut_local_map, simplify_graph
from scjax.data.tiles import pose_of
from scjax.scene import NO_EGO, Crop, Log, Scene


def crop_log(
    log: Log,
    step: int = 0,
    object_index: int | None = None,
    *,
    crop: Crop = Crop.CENTERED,
    domain: int = 0,
    off_road: bool = False,
) -> Scene:
    """The unpadded NumPy scene of ``log`` at ``step`` around one object, equal to that of a training record there.

    Lanes are clipped, resampled to 20 points and linked; unknown agent values are filled and flagged. Objects of
    another type than ``AgentType`` are left out.

    Args:
      object_index: the object that becomes agent 0; the log's ego by default.
      crop: the window around that object.
      domain: index of the data set, for ``Scene.domain``.
      off_road: keep vehicles parked off the road.

    Raises:
      ValueError: if there is no such step or object, the object is not valid at the step or of no known type, or the
        map has no lane that cars may use.
    """
    if object_index is None:
        object_index = log.ego_index
        if object_index == NO_EGO:
            raise ValueError("the log has no ego: say which object to crop around with object_index")
    if not 0 <= step < log.num_steps:
        raise ValueError(f"step is {step}: give one of the {log.num_steps} steps of the log, counted from 0")
    if not 0 <= object_index < log.num_objects:
        raise ValueError(f"object_index is {object_index}: give one of the {log.num_objects} objects of the log")
    if not log.valid[object_index, step]:
        valid = np.flatnonzero(log.valid[object_index]).tolist()
        raise ValueError(f"object {object_index} is not valid at step {step}: its valid steps are {valid}")
    if log.object_types[object_index] < 0:
        raise ValueError(f"object {object_index} has no AgentType: choose a vehicle, pedestrian, cyclist or obstacle")
    graph = build_graph(log)
    index = index_segments(graph)
    pose = pose_of(log, index, step, object_index)
    local_map, _ = cut_local_map(log, simplify_graph(graph), index, pose)
    return crop_scene(local_map, crop, domain=domain, off_road=off_road)
