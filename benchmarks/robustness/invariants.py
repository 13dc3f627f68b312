"""What must hold of every accepted result, written down a second time: nothing here calls scjax's own checks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

FARTHEST = 1e7  # m
_ENUMS = {"agent_types": 4, "signals": 4, "links": 6, "crop": 3}  # field -> number of values
_NONE, _PREDECESSOR, _SELF = 0, 1, 5
_INVERSE = np.array([0, 2, 1, 4, 3, 5])
_POINTS = 20


def scene_fault(scene: Any) -> str | None:
    """What is wrong with a scene or a batch of scenes, None if nothing is."""
    fields = {name: np.asarray(value) for name, value in scene.to_dict().items()}
    if "layout" in fields:
        fields["crop"] = fields.pop("layout")
    mask, lane_mask = fields["agent_mask"], fields["lane_mask"]
    lead, agents, lanes = mask.shape[:-1], mask.shape[-1], lane_mask.shape[-1]
    shapes = {
        "agents": (*lead, agents, 9),
        "agent_types": (*lead, agents),
        "agent_mask": (*lead, agents),
        "agent_known": (*lead, agents, 9),
        "lanes": (*lead, lanes, _POINTS, 3),
        "lane_mask": (*lead, lanes),
        "lane_known": (*lead, lanes, 3),
        "signals": (*lead, lanes),
        "links": (*lead, lanes, lanes),
        "crop": lead,
        "domain": lead,
    }
    for name, shape in shapes.items():
        kind = "b" if name.endswith(("mask", "known")) else "f" if name in ("agents", "lanes") else "iu"
        if fields[name].shape != shape:
            return f"{name} has shape {fields[name].shape}, not {shape}"
        if fields[name].dtype.kind not in kind:
            return f"{name} is {fields[name].dtype}"
    states, points = fields["agents"][mask].astype(np.float64), fields["lanes"][lane_mask].astype(np.float64)
    if not (np.abs(states) < FARTHEST).all():
        return f"agents hold {states[~(np.abs(states) < FARTHEST)][0]}"
    if not (np.abs(points) < FARTHEST).all():
        return f"lanes hold {points[~(np.abs(points) < FARTHEST)][0]}"
    if (states[:, 6:] <= 0).any():
        return f"a size is {states[:, 6:].min()}"
    if (np.abs(np.hypot(states[:, 4], states[:, 5]) - 1) > 0.011).any():
        return "a heading is no unit vector"
    pairs = lane_mask[..., :, None] & lane_mask[..., None, :]
    for name, number in _ENUMS.items():
        real = {"agent_types": mask, "signals": lane_mask, "links": pairs}.get(name, np.ones(lead, bool))
        used = fields[name][real]
        if used.size and not (0 <= used.min() and used.max() < number):
            return f"{name} holds {used.min()}..{used.max()}"
    if fields["domain"].size and fields["domain"].min() < 0:
        return f"domain is {fields['domain'].min()}"
    return _links_fault(fields["links"], lane_mask)


def _links_fault(links: np.ndarray, mask: np.ndarray) -> str | None:
    pairs = mask[..., :, None] & mask[..., None, :]
    diagonal = np.broadcast_to(np.eye(links.shape[-1], dtype=bool), links.shape)
    if ((links == _SELF) & pairs != diagonal & pairs).any():
        return "links are not SELF exactly on the diagonal"
    other = np.swapaxes(links, -1, -2)
    ring = (links == _PREDECESSOR) & (other == _PREDECESSOR)
    if ((_INVERSE[links.clip(0, 5)] != other) & pairs & ~ring).any():
        return "links contradict each other"
    return None


def log_fault(log: Any) -> str | None:
    """What is wrong with a log, None if nothing is."""
    steps, objects = len(log.timestamps), len(log.object_ids)
    shapes = {
        "object_types": (objects,),
        "valid": (objects, steps),
        "positions": (objects, steps, 3),
        "headings": (objects, steps),
        "velocities": (objects, steps, 2),
        "sizes": (objects, 3),
    }
    for name, shape in shapes.items():
        if np.shape(getattr(log, name)) != shape:
            return f"{name} has shape {np.shape(getattr(log, name))}, not {shape}"
    times = np.asarray(log.timestamps, float)
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        return "timestamps do not increase"
    for name in ("positions", "headings", "velocities"):
        values = np.asarray(getattr(log, name), float).reshape(objects, steps, -1)[..., :2][log.valid]
        if not (np.abs(values) < FARTHEST).all():
            return f"{name} hold {values[~(np.abs(values) < FARTHEST)][0]}"
    if not all(isinstance(name, str) for name in (*log.object_ids, *log.signal_lane_ids)):
        return "an id is no text"
    types, states = np.asarray(log.object_types), np.asarray(log.signal_states)
    if types.size and not (-1 <= types.min() and types.max() < 4):
        return f"object_types hold {types.min()}..{types.max()}"
    if states.size and not (0 <= states.min() and states.max() < 4):
        return f"signal_states hold {states.min()}..{states.max()}"
    if isinstance(log.ego_index, bool) or int(log.ego_index) != log.ego_index or not -1 <= log.ego_index < objects:
        return f"ego_index is {log.ego_index!r}"
    return _map_fault(log.lanes)


def _map_fault(lanes: Iterable[Any]) -> str | None:
    ids = [lane.id for lane in lanes]
    if len(set(ids)) < len(ids):
        return "two lanes have one id"
    for lane in lanes:
        points = np.asarray(lane.points, float)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            return f"a lane has points of shape {points.shape}"
        if not (np.abs(points[:, :2]) < FARTHEST).all():
            return f"a lane holds {points[~(np.abs(points[:, :2]) < FARTHEST).all(1)][0]}"
        if not isinstance(lane.id, str):
            return f"the id of a lane is {lane.id!r}"
        if not all(isinstance(name, str) for name in (*lane.predecessors, *lane.successors)):
            return f"lane {lane.id} has a neighbor that is no text"
    return None


def old_log_fault(scene: Any) -> str | None:
    """The same for a recording of the old code, whose ids are not kept."""
    for name in ("positions", "headings", "velocities"):
        values = np.asarray(getattr(scene, name), float)
        values = values.reshape(*scene.valid.shape, -1)[..., :2][scene.valid]
        if not (np.abs(values) < FARTHEST).all():
            return f"{name} hold {values[~(np.abs(values) < FARTHEST)][0]}"
    if not np.isfinite(np.asarray(scene.timestamps, float)).all() or (np.diff(scene.timestamps) <= 0).any():
        return "timestamps do not increase"
    for lane in scene.lanes:
        if not (np.abs(np.asarray(lane.points, float)[:, :2]) < FARTHEST).all():
            return "a lane holds NaN or absurd values"
    return None


def arrays_fault(tree: Any) -> str | None:
    """Whether any array in nested containers holds a number that is not finite."""
    if isinstance(tree, dict):
        parts = tree.items()
    elif isinstance(tree, list | tuple):
        parts = enumerate(tree)
    elif hasattr(tree, "__dataclass_fields__"):
        parts = [(name, getattr(tree, name)) for name in tree.__dataclass_fields__]
    else:
        array = np.asarray(tree) if hasattr(tree, "dtype") or isinstance(tree, float) else np.zeros(0)
        numbers = array.dtype.kind == "f" or array.dtype.name == "bfloat16"
        return None if not numbers or np.isfinite(array.astype(np.float64)).all() else "not finite"
    for name, part in parts:
        if fault := arrays_fault(part):
            return f"{name}: {fault}"
    return None
