"""The order of tokens. Position codes count along it, so it is a function of the scene alone (official-spec §3).

Runs on the host for every training example, with NumPy and plain lists.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from scjax.scene import Crop, Scene, permute
from scjax.scene.per_type import PerType

TOLERANCE = 0.5  # m
UNIT_TOLERANCE = TOLERANCE / 32  # in unit coordinates, -1..1 over a tile
Axes = Literal["xy", "yx"]  # nuPlan models of the release sort by x first, Waymo models by y


def token_permutations(
    lanes: Float[np.ndarray, "lanes points 2"],
    agents: Float[np.ndarray, "agents 2"],
    *,
    axes: Axes = "xy",
    tolerance: float = UNIT_TOLERANCE,
) -> PerType:
    """Permutations of agents and lanes: new row i is old row ``permutation[i]``. Agent 0, the ego, stays first.

    Keys are minimum x, minimum y, maximum x, maximum y. Elements whose key differs from their predecessor's by less
    than ``tolerance`` form a group, which is sorted by the next key. Ties keep their order.

    Args:
      lanes, agents: xy of all points and of the box centers, without padding; unit coordinates, or meters with
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


def sort_tokens(scene: Scene) -> tuple[Scene, Int[np.ndarray, " agents"], Int[np.ndarray, " lanes"]]:
    """One unpadded NumPy scene [m] in token order, and the permutations of its agents and lanes.

    In a partitioned scene the known half comes first, as it does when a scene is completed.
    """
    lanes, agents = np.asarray(scene.lanes)[..., :2], np.asarray(scene.agents)[..., :2]
    permutations = token_permutations(lanes, agents, tolerance=TOLERANCE)
    if scene.crop == Crop.PARTITIONED:
        known = known_half(lanes, agents)
        known_agents = known.agents.copy()
        known_agents[:1] = True
        permutations = PerType(
            agents=permutations.agents[np.argsort(~known_agents[permutations.agents], kind="stable")],
            lanes=permutations.lanes[np.argsort(~known.lanes[permutations.lanes], kind="stable")],
        )
    return permute(scene, permutations.agents, permutations.lanes), permutations.agents, permutations.lanes


def known_half(
    lanes: Float[np.ndarray, "lanes points 2"], agents: Float[np.ndarray, "agents 2"], *, axes: Axes = "xy"
) -> PerType:
    """The known half of a partitioned scene: agents at x <= 0, lanes whose middle point (10th of 20) is at x <= 0."""
    axis = "xy".index(axes[0])
    return PerType(agents=agents[:, axis] <= 0, lanes=lanes[:, lanes.shape[1] // 2 - 1, axis] <= 0)


def in_view(
    agents: Float[np.ndarray, "agents 2"], *, half_angle: float = np.deg2rad(50)
) -> Bool[np.ndarray, " agents"]:
    """Agents within ``half_angle`` [rad] of straight ahead of agent 0, the ego, which always counts."""
    offset = agents - agents[:1]
    inside = (offset[:, 0] > 0) & (np.abs(np.arctan2(offset[:, 1], offset[:, 0])) <= half_angle)
    inside[:1] = True
    return inside


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
