"""What the rules of rare events share: agents relative to their lanes, and the fields of a rule.

A single moment cannot show everything. The rules require a clear case away from junctions, because queues and turns
explain there what would be an event elsewhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int

from scjax.language.intersections import Intersection
from scjax.language.road import Road, wrap_to_pi
from scjax.scene import AgentType, Scene

STOPPED_SPEED = 0.1  # m/s, vehicles below are stopped
ALIGNED = 0.3  # rad between an agent and its lane, below which it follows the lane
MAX_COORDINATE = 32.0  # m, half the width of the scene

_MAX_EVENT_COORDINATE = 25.0  # m, events nearer to the border may be cut off
_JUNCTION_DISTANCE = 18.0  # m of road around a fork, a merge or a sharp turn without events
_QUEUE_DISTANCE = 8.0  # m around an intersection where vehicles wait
_FORK_TURN = 0.3  # rad, of a branch of a fork or merge that is a junction
_SHARP_TURN = 0.6  # rad of turn over a whole lane
_SHARP_CURVATURE = 1 / 40  # rad/m, above it a bend is a turn at a junction
_HEADING_COST = 0.5  # m per rad in the choice of the lane that an agent follows


@dataclasses.dataclass(frozen=True)
class AgentLaneRelations:
    """Agents without the ego, relative to the lanes of the road.

    Attributes:
      road: the lanes.
      positions, headings, speeds, lengths: of the agents [m, rad, m/s, m].
      is_vehicle, is_pedestrian, is_static: by type.
      is_eligible: inside the central part of the scene and away from junctions.
      lane: the nearest lane; among overlapping lanes the one with the agent's heading.
      distances: to every lane [m].
      angles: absolute angle between agent and lane, at the nearest point of every lane [rad].
      lateral: offset to the left of the centerline of ``lane`` [m].
      angle: heading relative to ``lane`` [rad], positive to the left.
      all_agents: states of all agents, the ego included, as in ``Scene.agents``.
      all_vehicles: which of them are vehicles.
    """

    road: Road
    positions: Float64[np.ndarray, "agents 2"]
    headings: Float64[np.ndarray, " agents"]
    speeds: Float64[np.ndarray, " agents"]
    lengths: Float64[np.ndarray, " agents"]
    is_vehicle: Bool[np.ndarray, " agents"]
    is_pedestrian: Bool[np.ndarray, " agents"]
    is_static: Bool[np.ndarray, " agents"]
    is_eligible: Bool[np.ndarray, " agents"]
    lane: Int[np.ndarray, " agents"]
    distances: Float64[np.ndarray, "agents lanes"]
    angles: Float64[np.ndarray, "agents lanes"]
    lateral: Float64[np.ndarray, " agents"]
    angle: Float64[np.ndarray, " agents"]
    all_agents: Float64[np.ndarray, "all 9"]
    all_vehicles: Bool[np.ndarray, " all"]


class EventRule(NamedTuple):
    """One rare event.

    Attributes:
      event: name of the event in facts and labels.
      phrases: noun phrases for captions.
      prompt_pattern: regular expression for prompts in lower case.
      detect: whether a scene shows the event.
    """

    event: str
    phrases: tuple[str, ...]
    prompt_pattern: str
    detect: Callable[[AgentLaneRelations], bool]


def relate_agents_to_lanes(scene: Scene, road: Road, intersections: list[Intersection]) -> AgentLaneRelations:
    """Relations for one scene without padding with at least one lane and two agents; agent 0 is the ego."""
    all_agents, all_types = np.asarray(scene.agents, np.float64), np.asarray(scene.agent_types)
    agents, types = all_agents[1:], all_types[1:]
    positions, headings = agents[:, :2], np.arctan2(agents[:, 5], agents[:, 4])
    point_distances = np.linalg.norm(positions[:, None, None] - road.points[None], axis=-1)
    distances = point_distances.min(-1)
    nearest_segment = np.minimum(point_distances.argmin(-1), road.headings.shape[1] - 1)
    angles = np.abs(wrap_to_pi(headings[:, None] - road.headings[np.arange(len(road)), nearest_segment]))
    lane = (distances + _HEADING_COST * angles).argmin(-1)
    point = point_distances[np.arange(len(agents)), lane].argmin(-1)
    lane_heading = road.headings[lane, np.minimum(point, road.headings.shape[1] - 1)]
    offset = positions - road.points[lane, point]
    is_inside = np.abs(positions).max(-1) < _MAX_EVENT_COORDINATE
    return AgentLaneRelations(
        road=road,
        positions=positions,
        headings=headings,
        speeds=agents[:, 3],
        lengths=agents[:, 6],
        is_vehicle=types == AgentType.VEHICLE,
        is_pedestrian=types == AgentType.PEDESTRIAN,
        is_static=types == AgentType.STATIC,
        is_eligible=is_inside & ~_near_junction(positions, road, intersections),
        lane=lane,
        distances=distances,
        angles=angles,
        lateral=np.cos(lane_heading) * offset[:, 1] - np.sin(lane_heading) * offset[:, 0],
        angle=wrap_to_pi(headings - lane_heading),
        all_agents=all_agents,
        all_vehicles=all_types == AgentType.VEHICLE,
    )


def _near_junction(positions: np.ndarray, road: Road, intersections: list[Intersection]) -> np.ndarray:
    """Which positions are close to a fork, a merge, a sharp turn or an intersection [agents]."""
    turns = np.abs(road.bends.sum(1)) > _FORK_TURN  # a fork whose branches all go straight on opens a lane
    junctions = [
        road.points[k, end]
        for end, neighbors in ((-1, road.successors), (0, road.predecessors))
        for k in range(len(road))
        if len(neighbors[k]) > 1 and turns[list(neighbors[k])].any()
    ]
    near = np.zeros(len(positions), bool)
    if junctions:
        near |= _within(positions, np.array(junctions))
    # A turn whose approach has a lane of its own starts at no fork.
    segment_length = road.length[:, None] / (road.points.shape[1] - 1)
    is_tight = np.abs(road.bends) > _SHARP_CURVATURE * segment_length
    is_sharp = (np.abs(road.bends).sum(1) > _SHARP_TURN)[:, None] & is_tight
    if is_sharp.any():
        near |= _within(positions, road.points[:, 1:-1][is_sharp])
    for intersection in intersections:
        distance = np.linalg.norm(positions - intersection.center, axis=-1)
        near |= distance < intersection.radius + _QUEUE_DISTANCE
    return near


def _within(positions: np.ndarray, points: np.ndarray) -> np.ndarray:
    distances = np.linalg.norm(positions[:, None] - points[None], axis=-1)
    return (distances < _JUNCTION_DISTANCE).any(1)
