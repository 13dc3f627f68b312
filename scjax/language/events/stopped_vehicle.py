"""Vehicles that block a lane: stopped in the lane, or double parked beside a parked vehicle."""

from __future__ import annotations

import numpy as np

from scjax.language.events.base import ALIGNED, MAX_COORDINATE, STOPPED_SPEED, AgentLaneRelations, EventRule

_MAX_LATERAL = 1.3  # m from the centerline
_LEADER_GAP = 14.0  # m ahead, within which a lead vehicle explains the stop
_LEADER_LATERAL = 1.6  # m to the side of the lead vehicle
_EDGE_LATERAL = 0.5  # m off the centerline of a double-parked vehicle at least
_PARKED_DISTANCE = 9.0  # m to the vehicle that is parked beside it
_PARKED_LATERAL = 1.6  # m off the centerline of a parked vehicle at least


def _blocks_lane(relations: AgentLaneRelations) -> np.ndarray:
    """Which vehicles stand in a lane without a lead vehicle [agents]."""
    in_lane = (np.abs(relations.lateral) < _MAX_LATERAL) & (np.abs(relations.angle) < ALIGNED)
    blocks = relations.is_vehicle & relations.is_eligible & (relations.speeds < STOPPED_SPEED) & in_lane
    others = relations.all_agents
    for k in np.flatnonzero(blocks):
        cos, sin = np.cos(relations.headings[k]), np.sin(relations.headings[k])
        offset = others[:, :2] - relations.positions[k]
        along, left = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
        gap = along - (others[:, 6] + relations.lengths[k]) / 2
        has_leader = ((along > 0.5) & (gap < _LEADER_GAP) & (np.abs(left) < _LEADER_LATERAL)).any()
        road_ahead = np.abs(relations.positions[k] + _LEADER_GAP * np.array([cos, sin])).max()
        blocks[k] = road_ahead < MAX_COORDINATE and not has_leader
    return blocks


def _is_double_parked(relations: AgentLaneRelations, blocks: np.ndarray) -> np.ndarray:
    """Which of the vehicles that block a lane stand at its edge, beside a parked vehicle [agents]."""
    parked = relations.is_vehicle & (relations.speeds < STOPPED_SPEED) & (np.abs(relations.lateral) > _PARKED_LATERAL)
    parked &= np.abs(np.sin(relations.angle)) < ALIGNED
    double_parked = np.zeros(len(blocks), bool)
    for k in np.flatnonzero(blocks & (np.abs(relations.lateral) > _EDGE_LATERAL)):
        near = parked & (np.linalg.norm(relations.positions - relations.positions[k], axis=-1) < _PARKED_DISTANCE)
        double_parked[k] = (near & (relations.lateral * relations.lateral[k] > 0)).any()
    return double_parked


def _detect_stopped(relations: AgentLaneRelations) -> bool:
    blocks = _blocks_lane(relations)
    return bool((blocks & ~_is_double_parked(relations, blocks)).any())


def _detect_double_parking(relations: AgentLaneRelations) -> bool:
    return bool(_is_double_parked(relations, _blocks_lane(relations)).any())


STOPPED_VEHICLE = EventRule(
    "stopped vehicle in lane",
    ("a vehicle stopped in its lane", "a broken-down vehicle blocking a lane"),
    r"(?:stopped|broken[- ]down|stalled) (?:vehicle|car)?.*lane|blocking a lane",
    _detect_stopped,
)
DOUBLE_PARKING = EventRule(
    "double parking",
    ("a double-parked vehicle", "a vehicle double parked beside the kerb"),
    r"double[- ]park",
    _detect_double_parking,
)
