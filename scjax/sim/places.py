"""Where agents are on the lanes at the start; NumPy on the host."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

from scjax.scene import AgentType
from scjax.scene.angles import wrap_to_pi
from scjax.sim.agents import LanePlaces
from scjax.sim.network_of_map import LanePoints
from scjax.sim.road_network import NONE

_RADIUS, _NEAR = 3.5, 2.5  # m to a centerline: of moving vehicles, and of standing ones
_ANGLE, _WIDE_ANGLE = np.deg2rad(60.0), np.deg2rad(45.0)
_PARKED_SPEED, _PARKED_OFFSET = 0.5, 1.6  # m/s, m
_PARALLEL = np.cos(np.deg2rad(15.0))
_ANGLE_COST = 3.0  # m for each rad: which of several lanes an agent follows


def place_agents(
    lanes: LanePoints, states: Float64[np.ndarray, "N 9"], types: Int[np.ndarray, " N"], ego: int | None = None
) -> LanePlaces:
    """The lane that each vehicle or cyclist follows: near, and in its direction.

    Standing vehicles that follow no lane, or stand aside of it and not between two, are parked. Pedestrians follow no
    lane. Obstacles are parked.

    Args:
      states: columns of ``Scene.agents`` in the frame of the lanes.
      types: ``AgentType``.
      ego: row of the agent that is not parked, wherever it stands on its lane.
    """
    from scipy.spatial import KDTree

    count = len(states)
    lane, along, lateral, angle = np.full(count, NONE), np.zeros(count), np.zeros(count), np.zeros(count)
    between = np.zeros(count, bool)  # two lanes of any direction
    headings = np.arctan2(states[:, 5], states[:, 4])
    found = KDTree(lanes.points[:, :2]).query_ball_point(states[:, :2], _RADIUS + 1.0) if count else []
    for row in range(count):
        if types[row] not in (AgentType.VEHICLE, AgentType.CYCLIST) or not found[row]:
            continue
        near = np.array(found[row], int)
        offset = states[row, :2] - lanes.points[near, :2]
        cos, sin = np.cos(lanes.headings[near]), np.sin(lanes.headings[near])
        ahead, side = offset[:, 0] * cos + offset[:, 1] * sin, -offset[:, 0] * sin + offset[:, 1] * cos
        turn = wrap_to_pi(headings[row] - lanes.headings[near])
        limit = _RADIUS if states[row, 3] > _PARKED_SPEED else _NEAR
        fits = (np.abs(side) < limit) & (np.abs(turn) < _ANGLE) & (np.abs(ahead) < 1.0)
        if not fits.any():
            continue
        cost = np.where(fits, np.abs(side) + _ANGLE_COST * np.abs(turn) + 0.1 * np.abs(ahead), np.inf)
        best = int(cost.argmin())
        lane[row], lateral[row], angle[row] = lanes.lane[near[best]], side[best], turn[best]
        along[row] = lanes.along[near[best]] + ahead[best]
        from_best = np.cos(turn - turn[best])  # -1 on lanes of the other direction, whose left is the right of this one
        beside = (side * side[best] * from_best < 0) & (np.abs(ahead) < 1.0) & (np.abs(from_best) > _PARALLEL)
        between[row] = beside.any()
    stands = states[:, 3] < _PARKED_SPEED
    off_center = (np.abs(lateral) > _PARKED_OFFSET) & ~between
    if ego is not None:  # it drives by definition
        off_center[ego] = False
    aside = (lane == NONE) | off_center | (np.abs(angle) > _WIDE_ANGLE)
    parked = stands & aside & np.isin(types, (AgentType.VEHICLE, AgentType.CYCLIST))
    parked |= types == AgentType.STATIC
    lane[parked] = NONE
    return LanePlaces(
        lane=lane.astype(np.int32),
        along=along.astype(np.float32),
        lateral=lateral.astype(np.float32),
        heading=angle.astype(np.float32),
        is_parked=parked,
    )
