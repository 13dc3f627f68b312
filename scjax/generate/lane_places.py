"""Places on known lanes for the agents of an outline, whose kinds are of another scene.

A kind says direction, side of the ego, distance and whether the agent is on a lane. On other lanes there may be no such
place, and a network then puts the agent across a lane or beside one. So each agent gets a place that these lanes have,
as near to its kind as they allow and apart from the others. Its kind and its turn in the order follow from that place.
After sampling, agents that are to go along a lane, and do not, move to the nearest one of their direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.data.token_order import TOLERANCE, token_permutations
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.kinds import (
    NO_KIND,
    SECTORS,
    agent_digits,
    digits_of,
    distances_from_ego,
    sectors_of,
    sides_of_ego,
)
from scjax.scene import TILE_SIZE, AgentType, Scene
from scjax.scene.agent_sizes import CLASS_SIZES
from scjax.scene.angles import wrap_to_pi
from scjax.scene.boxes import overlaps
from scjax.scene.polyline import spread_points
from scjax.scene.scene import LARGE_LENGTH

_SPACING, _GRID = 1.0, 2.0  # m between places along lanes, and anywhere
_SPEEDS = (0.0, 2.0, 8.0, 15.0)  # m/s, one of each class of speeds
_LENGTH_OF_LARGE = LARGE_LENGTH + 3.0  # m
_APART, _ABREAST = 2.0, 2.2  # m between boxes along a lane, and between middles of lanes, so that vehicles pass
_ON_LANE, _BESIDE = 1.4, 4.5  # m from the middle of a lane; agents beside it are nearer than the second
_ALONG = 1  # digit of agents in the middle of a lane and along it
_TAKEN = 100.0  # cost of a place where somebody is
_DIRECTION, _SIDE, _DISTANCE, _LANE = 2.0, 1.5, 1.0, 3.0  # costs of another direction, side, distance, and off lanes
_DRIVERS = (AgentType.VEHICLE, AgentType.CYCLIST)
_FARTHEST = 8.0  # m to a lane that an agent moves to
_LATERAL, _SKEW = 0.5, np.deg2rad(10.0)  # m and rad that agents may be off their lane's middle and direction
_OWN_WAY = np.deg2rad(45.0)  # from an agent's direction, for lanes that are its own


class _Places(NamedTuple):
    """Places in a scene.

    Attributes:
      poses: x, y [m] and direction of the nearest lane [places, 3].
      reach: m to the middle of that lane.
      sectors, sides, distances: digits of the kinds of agents there that go along it.
    """

    poses: Float64[np.ndarray, "places 3"]
    reach: Float64[np.ndarray, " places"]
    sectors: Int[np.ndarray, " places"]
    sides: Int[np.ndarray, " places"]
    distances: Int[np.ndarray, " places"]


def settle_agents(
    rng: np.random.Generator, kinds: Int[np.ndarray, " tokens"], known: Scene, codec: SceneCodec
) -> Scene | None:
    """The known elements, and agents of further kinds at places that the known lanes have, in token order.

    Args:
      kinds: of the known agents, the ego first, then of others.
      known: known elements in token order, unpadded: the ego and all lanes of the scene at least.

    Returns:
      None where no place is to be found: no lanes, or a kind that is open.
    """
    first = len(known.agent_mask)
    points, headings = _lane_points(known, _SPACING)
    if not len(points) or not first or (kinds == NO_KIND).any():
        return None
    agents = np.asarray(known.agents, np.float64)
    on_lanes, anywhere = _places(points, headings, agents[0])
    taken = [np.array([one[0], one[1], np.arctan2(one[5], one[4]), one[6]]) for one in agents]
    digits = np.stack(digits_of(kinds[first:], agent_digits(codec)), 1)
    types = np.array([*codec.agent_types, AgentType.VEHICLE], np.int32)[digits[:, 0]]
    new, along = np.zeros((len(digits), 9)), along_lanes(kinds[first:], codec)
    for row in rng.permutation(len(digits)):
        is_along = bool(along[row])
        places = on_lanes if is_along else anywhere
        is_large = bool(digits[row, 0] == len(codec.agent_types))
        new[row], box = _settled(rng, digits[row], AgentType(types[row]), is_along, is_large, places, taken)
        taken.append(box)
    centers = np.concatenate([np.zeros((1, 2)), new[:, :2]])
    order = token_permutations(np.zeros((0, 1, 2)), centers, tolerance=TOLERANCE).agents[1:] - 1
    return known.replace(
        agents=np.concatenate([agents, new[order]]).astype(np.float32),
        agent_types=np.concatenate([known.agent_types, types[order]]).astype(np.int32),
        agent_mask=np.ones(first + len(new), bool),
        agent_known=np.concatenate([known.agent_known, np.ones((len(new), 9), bool)]),
    )


def along_lanes(kinds: Int[np.ndarray, " tokens"], codec: SceneCodec) -> Bool[np.ndarray, " tokens"]:
    """Which kinds are those of vehicles and cyclists in the middle of a lane and along it."""
    classes, _, _, lane, _, _ = digits_of(np.maximum(kinds, 0), agent_digits(codec))
    drivers = [row for row, type in enumerate((*codec.agent_types, AgentType.VEHICLE)) if type in _DRIVERS]
    return (kinds != NO_KIND) & (lane == _ALONG) & np.isin(classes, drivers)


def keep_to_lanes(scene: Scene, along: Bool[np.ndarray, " agents"]) -> Scene:
    """A scene whose agents ``along`` go along the nearest lane of their direction, within 0.5 m of its middle.

    Agents stay where no such lane is within 8 m, or where they would share ground with more others than before.

    Args:
      scene: single, unpadded.
    """
    points, headings = _lane_points(scene, _SPACING / 2)
    if not len(points) or not along.any():
        return scene
    agents = np.array(scene.agents)
    for row in np.flatnonzero(along):
        yaw, moved = np.arctan2(agents[row, 5], agents[row, 4]), agents.copy()
        distance = np.hypot(*(points - agents[row, :2]).T)
        distance[np.abs(wrap_to_pi(headings - yaw)) > _OWN_WAY] = np.inf
        nearest = int(distance.argmin())
        if distance[nearest] > _FARTHEST:
            continue
        offset = agents[row, :2] - points[nearest]
        moved[row, :2] = points[nearest] + offset * min(1.0, _LATERAL / max(distance[nearest], _LATERAL))
        if abs(wrap_to_pi(headings[nearest] - yaw)) > _SKEW:
            moved[row, 4:6] = np.cos(headings[nearest]), np.sin(headings[nearest])
        if overlaps(moved)[row].sum() <= overlaps(agents)[row].sum():
            agents = moved
    return scene.replace(agents=agents)


def _lane_points(scene: Scene, spacing: float) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Points on the middles of all lanes, about ``spacing`` apart [m], and the directions of the lanes there [rad]."""
    lines = [spread_points(np.asarray(lane, np.float64)[:, :2], spacing) for lane in scene.lanes]
    lines = [line for line in lines if len(line) > 1]
    if not lines:
        return np.zeros((0, 2)), np.zeros(0)
    headings = [np.arctan2(*np.gradient(line, axis=0).T[::-1]) for line in lines]
    return np.concatenate(lines), np.concatenate(headings)


def _places(
    points: Float64[np.ndarray, "n 2"], headings: Float64[np.ndarray, " n"], ego: Float64[np.ndarray, " 9"]
) -> tuple[_Places, _Places]:
    """Places in the middle of lanes, and on a grid over the window."""
    from scipy.spatial import KDTree

    axis = np.arange(-TILE_SIZE / 2 + _GRID / 2, TILE_SIZE / 2, _GRID)
    grid = np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2)
    reach, nearest = KDTree(points).query(grid)
    turn = np.array([[ego[4], -ego[5]], [ego[5], ego[4]]])

    def of(some: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> _Places:
        from_ego = (some - ego[:2]) @ turn
        digits = sectors_of(directions), sides_of_ego(from_ego), distances_from_ego(from_ego)
        return _Places(np.column_stack([some, directions]), reach, *(np.asarray(one) for one in digits))

    return of(points, headings, np.zeros(len(points))), of(grid, headings[nearest], np.asarray(reach))


def _settled(
    rng: np.random.Generator,
    digits: Int[np.ndarray, " digits"],
    type: AgentType,
    is_along: bool,
    is_large: bool,
    places: _Places,
    taken: Sequence[Float64[np.ndarray, " 4"]],
) -> tuple[Float64[np.ndarray, " 9"], Float64[np.ndarray, " 4"]]:
    """An agent whose kind is as near to these digits as the places allow, and its box: x, y, direction, length."""
    _, speed, direction, lane, side, distance = digits.tolist()
    length, width, height = CLASS_SIZES[type]
    length = _LENGTH_OF_LARGE if is_large else length
    cost = _SIDE * (places.sides != side) + _DISTANCE * np.abs(places.distances - distance)
    if is_along:
        apart = np.abs(places.sectors - direction)
        cost += _DIRECTION * np.minimum(apart, SECTORS - apart)
    else:
        cost += _LANE * ((places.reach < _ON_LANE) != (lane > 0))
    if not is_along and type == AgentType.VEHICLE:
        across = (places.sectors - direction) % (SECTORS // 2) != 0
        cost += _DIRECTION * across + _DISTANCE * (places.reach > _BESIDE)
    cost += _TAKEN * _are_taken(places, taken, length)
    row = int(rng.choice(np.flatnonzero(cost <= cost.min() + 1e-9)))
    x, y, yaw = places.poses[row]
    angle = yaw if is_along else direction * 2 * np.pi / SECTORS
    agent = [x, y, height / 2, _SPEEDS[speed], np.cos(angle), np.sin(angle), length, width, height]
    return np.array(agent), np.array([x, y, yaw, length])


def _are_taken(
    places: _Places, taken: Sequence[Float64[np.ndarray, " 4"]], length: float
) -> Bool[np.ndarray, " places"]:
    """Whether an agent of this length would be within one of the boxes, or close to it."""
    result = np.zeros(len(places.poses), bool)
    for x, y, yaw, other in taken:
        cos, sin = np.cos(yaw), np.sin(yaw)
        along, across = np.abs((places.poses[:, :2] - np.array([x, y])) @ np.array([[cos, -sin], [sin, cos]])).T
        result |= (along < (length + other) / 2 + _APART) & (across < _ABREAST)
    return result
