"""The agents of a new tile: beside the lanes that bends move, on uncovered ground, and in nobody's way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int

from scjax.outpainting.bends import Bends
from scjax.outpainting.coverage import Coverage
from scjax.outpainting.window import HALF, KnownWindow
from scjax.scene import AgentType, Scene
from scjax.scene.angles import wrap_to_pi
from scjax.scene.boxes import overlaps
from scjax.scene.polyline import cumulative_length, point_headings, smoothstep

_WITH_LANE, _FREE = 4.0, 10.0  # m from a lane, up to which agents move as it does, and from which they stay
_STEP = 0.25  # m between places of lanes
_OTHER_WAY = 10.0  # m by which a lane that leads another way than a vehicle counts as farther away
_OWN_WAY = np.deg2rad(60.0)
_INSIDE = 0.5  # m inside of covered ground, from where agents are left out


def sampled_agents(
    sample: Scene, window: KnownWindow
) -> tuple[Float64[np.ndarray, "agents 9"], Int[np.ndarray, " agents"]]:
    """The agents of a sampled window that are not known, in the frame of the map, and their types."""
    count, pose = len(window.scene.agents), window.pose
    agents, types = np.array(sample.agents, np.float64)[count:], np.asarray(sample.agent_types, np.int32)[count:]
    agents[:, :3] = pose.to_map(agents[:, :3])
    agents[:, 4:6] = _turned(agents[:, 4:6], np.full(len(agents), pose.yaw))
    return agents, types


def move_beside(
    agents: Float64[np.ndarray, "agents 9"],
    types: Int[np.ndarray, " agents"],
    lines: Sequence[Float64[np.ndarray, "_ 3"]],
    bends: Bends,
) -> Float64[np.ndarray, "agents 9"]:
    """Agents that keep their place beside the nearest lane, and their heading to it, where bends move lanes.

    Up to 4 m from its lane an agent moves as the lane does, and less beyond, until it stays from 10 m on. For vehicles
    a lane of their own direction counts before others.

    Args:
      lines: the lanes before they bend.
    """
    places = [np.arange(0.0, cumulative_length(line)[-1], _STEP) for line in lines]
    row = np.concatenate([np.full(len(some), k) for k, some in enumerate(places)]) if places else np.zeros(0, int)
    if not len(agents) or not len(row):
        return agents
    before = [_at(line, some) for line, some in zip(lines, places, strict=True)]
    after = [points + bends.shifts(k, some) for k, (points, some) in enumerate(zip(before, places, strict=True))]
    headings, turned = (np.concatenate([point_headings(points) for points in some]) for some in (before, after))
    points, shifts = np.concatenate(before), np.concatenate(after) - np.concatenate(before)

    distance = np.hypot(*np.moveaxis(agents[:, None, :2] - points[None, :, :2], -1, 0))
    other_way = np.abs(wrap_to_pi(np.arctan2(agents[:, 5], agents[:, 4])[:, None] - headings)) > _OWN_WAY
    is_vehicle = types == AgentType.VEHICLE
    nearest = (distance + _OTHER_WAY * (other_way & is_vehicle[:, None])).argmin(1)
    away = distance[np.arange(len(agents)), nearest]
    share = 1.0 - smoothstep((away - _WITH_LANE) / (_FREE - _WITH_LANE))
    turn = share * wrap_to_pi(turned - headings)[nearest]
    foot, moved = points[nearest], np.array(agents)
    moved[:, :2] = foot[:, :2] + share[:, None] * shifts[nearest, :2] + _turned(agents[:, :2] - foot[:, :2], turn)
    moved[:, 2] += share * shifts[nearest, 2]
    moved[:, 4:6] = _turned(agents[:, 4:6], turn)
    return moved


def free_agents(
    agents: Float64[np.ndarray, "agents 9"],
    types: Int[np.ndarray, " agents"],
    window: KnownWindow,
    coverage: Coverage,
) -> tuple[Float64[np.ndarray, "n 9"], Int[np.ndarray, " n"]]:
    """Those agents on uncovered ground, without those in or on others."""
    pose, new = window.pose, ~coverage.contains(agents[:, :2], _INSIDE)
    agents, types = agents[new], types[new]
    others = window.map.agents
    near = np.hypot(*(others[:, :2] - np.array([pose.x, pose.y])).T) < 2 * HALF
    others = others[near & ~np.isnan(others[:, 6:8]).any(-1)]
    is_overlap = overlaps(np.concatenate([others, agents]))
    free = np.array([not row.any() for row in is_overlap[len(others) :, : len(others)]], bool)
    for row in range(len(agents)):
        free[row] &= not (is_overlap[len(others) + row, len(others) :][:row] & free[:row]).any()
    return agents[free], types[free]


def _at(line: Float64[np.ndarray, "points 3"], places: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
    arc = cumulative_length(line)
    return np.stack([np.interp(places, arc, column) for column in line.T], -1)


def _turned(vectors: Float64[np.ndarray, "n 2"], angle: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 2"]:
    (x, y), cos, sin = vectors.T, np.cos(angle), np.sin(angle)
    return np.stack([cos * x - sin * y, sin * x + cos * y], -1)
