"""Token order: position codes count along it, so it must be a function of the scene alone (official-spec §3).

Host side, NumPy and plain lists: it runs on every access of a training example.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from scjax.scene import Crop, Scene, permute
from scjax.scene.per_type import PerType

TOLERANCE = 0.5  # metres
UNIT_TOLERANCE = TOLERANCE / 32
Axes = Literal["xy", "yx"]  # nuPlan models of the release sort by x first, Waymo models by y


def order(
    lanes: Float[np.ndarray, "lanes points 2"],
    agents: Float[np.ndarray, "agents 2"],
    *,
    axes: Axes = "xy",
    tolerance: float = UNIT_TOLERANCE,
) -> PerType:
    """Permutations: new row i is old row ``perm[i]``. Agent 0 (the ego) stays first.

    Sorted by least x, least y, greatest x, greatest y: elements whose key differs from their predecessor's by less
    than ``tolerance`` form a group (groups chain), which is sorted by the next key. Ties keep their order.

    Args:
      lanes, agents: xy of all points and of the box centres, without padding; unit coordinates, or metres with
        ``tolerance=TOLERANCE``.
      axes: which coordinate comes first.
    """
    if axes == "yx":
        lanes, agents = lanes[..., ::-1], agents[..., ::-1]
    lane_keys = np.concatenate([lanes.min(1), lanes.max(1)], 1).T.tolist()
    agent_keys = [*agents.T.tolist()] * 2
    return PerType(
        agents=np.array([0, *_sort(range(1, len(agents)), agent_keys, tolerance)] if len(agents) else [], np.int32),
        lanes=np.array(_sort(range(len(lanes)), lane_keys, tolerance), np.int32),
    )


def arrange(scene: Scene) -> tuple[Scene, Int[np.ndarray, " agents"], Int[np.ndarray, " lanes"]]:
    """One unpadded NumPy scene (metres) in token order, and the permutations of its agents and lanes.

    In a partitioned scene the given half comes first, as it does when a scene is completed.
    """
    lanes, agents = np.asarray(scene.lanes)[..., :2], np.asarray(scene.agents)[..., :2]
    perms = order(lanes, agents, tolerance=TOLERANCE)
    if scene.crop == Crop.PARTITIONED:
        given = partition(lanes, agents)
        ego_first = given.agents.copy()
        ego_first[:1] = True
        perms = PerType(
            agents=perms.agents[np.argsort(~ego_first[perms.agents], kind="stable")],
            lanes=perms.lanes[np.argsort(~given.lanes[perms.lanes], kind="stable")],
        )
    return permute(scene, perms.agents, perms.lanes), perms.agents, perms.lanes


def partition(
    lanes: Float[np.ndarray, "lanes points 2"], agents: Float[np.ndarray, "agents 2"], *, axes: Axes = "xy"
) -> PerType:
    """The given half of a partitioned scene: agents at x <= 0, lanes whose middle point (10th of 20) is at x <= 0."""
    first = "xy".index(axes[0])
    return PerType(agents=agents[:, first] <= 0, lanes=lanes[:, lanes.shape[1] // 2 - 1, first] <= 0)


def in_view(
    agents: Float[np.ndarray, "agents 2"], *, half_angle: float = np.deg2rad(50)
) -> Bool[np.ndarray, " agents"]:
    """Agents within ``half_angle`` [rad] of straight ahead of agent 0, the ego, which always counts."""
    offset = agents - agents[:1]
    ahead = (offset[:, 0] > 0) & (np.abs(np.arctan2(offset[:, 1], offset[:, 0])) <= half_angle)
    ahead[:1] = True
    return ahead


def _sort(items, keys: list[list[float]], tolerance: float) -> list[int]:
    """``items`` by ``keys[0]``, and groups of near-equal ones by the remaining keys."""
    items = sorted(items, key=keys[0].__getitem__)
    if len(keys) == 1 or len(items) < 2:
        return items
    key, result, start = keys[0], [], 0
    for end in range(1, len(items) + 1):
        if end == len(items) or key[items[end]] - key[items[end - 1]] >= tolerance:
            group = items[start:end]
            result += group if len(group) == 1 else _sort(group, keys[1:], tolerance)
            start = end
    return result
