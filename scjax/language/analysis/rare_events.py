"""Rare events that agents and lanes show."""

from __future__ import annotations

import numpy as np

from scjax.language.analysis.platoons import leader_gaps
from scjax.language.analysis.scene_analysis import Analysis
from scjax.scene import AgentType, Signal

EVENTS = (
    "wrong-way",
    "jaywalker",
    "stopped-in-lane",
    "double-parking",
    "emergency-corridor",
    "cut-in",
    "work-zone",
)
_MOVING, _STANDING = 0.5, 0.5  # m/s
_WRONG_DISTANCE, _OWN_DISTANCE, _OWN_ANGLE = 1.4, 2.5, np.deg2rad(125.0)
_ROAD_HALF_WIDTH = 1.75  # m
_JUNCTION_FREE, _BORDER_FREE = 12.0, 3.0  # m around a jaywalker
_STOP_LATERAL, _STOP_ANGLE = 1.4, np.deg2rad(30.0)  # of a vehicle that stands in its lane
_STOP_CAUSE = 14.0  # m ahead, within which a leader, a light or a junction explains a stop
_BESIDE_ALONG, _BESIDE_ACROSS = 6.0, 4.5  # m between a double-parked vehicle and the parked one
_PARKED_LATERAL = 1.4  # m off the lane
_CORRIDOR_LATERAL, _CORRIDOR_SPEED, _CORRIDOR_SPACING = 0.35, 4.0, 7.5  # m, m/s, m
_CUT_SPEED, _CUT_ANGLE, _CUT_OFFSET, _CUT_FOLLOWER = 2.0, np.deg2rad((2.0, 25.0)), 0.4, 17.0
_WORK_OBJECTS, _WORK_DISTANCE = 3, 8.0


def find_rare_events(scene: Analysis) -> tuple[str, ...]:
    """Names of the events of a scene, in the order of ``EVENTS``."""
    if not len(scene.lines):
        return ()
    stopped, double = _blocking(scene)
    shown = {
        "wrong-way": _has_wrong_way(scene),
        "jaywalker": _has_jaywalker(scene),
        "stopped-in-lane": stopped,
        "double-parking": double,
        "emergency-corridor": _has_corridor(scene),
        "cut-in": _has_cut_in(scene),
        "work-zone": _has_work_zone(scene),
    }
    return tuple(name for name in EVENTS if shown[name])


def _has_wrong_way(scene: Analysis) -> bool:
    near = scene.relations
    on_road = near.offset < _WRONG_DISTANCE
    own_way = ((near.distance < _OWN_DISTANCE) & (near.angle < _OWN_ANGLE)).any(1)
    return bool((scene.vehicles & (scene.speeds > _MOVING) & on_road & ~own_way).any())


def _has_jaywalker(scene: Analysis) -> bool:
    walkers = scene.is_type(AgentType.PEDESTRIAN) & (scene.relations.offset < _ROAD_HALF_WIDTH)
    walkers &= scene.junction_distance(scene.agents[:, :2]) >= _JUNCTION_FREE
    return bool((walkers & (scene.border_distance(scene.agents[:, :2]) >= _BORDER_FREE)).any())


def _blocking(scene: Analysis) -> tuple[bool, bool]:
    """Whether a vehicle stands in its lane without a cause in sight, and whether one stands beside a parked one."""
    near = scene.relations
    lane = near.lane
    rows = np.arange(len(lane))
    lateral, angle = near.lateral[rows, lane], near.angle[rows, lane]
    stands = scene.vehicles & (scene.speeds < _STANDING) & (lane >= 0)
    stands &= (np.abs(lateral) < _STOP_LATERAL) & (angle < _STOP_ANGLE)
    if not stands.any():
        return False, False
    everyone = np.flatnonzero(scene.is_type(AgentType.VEHICLE))
    _, gap = leader_gaps(scene.lines, near, scene.agents, everyone)
    free = np.full(len(lane), np.inf)
    free[everyone] = gap
    parked = scene.parked_vehicles
    stopped = double = False
    for k in np.flatnonzero(stands & (free > _STOP_CAUSE)):
        if scene.border_distance(scene.agents[k : k + 1, :2])[0] < _BORDER_FREE:
            continue
        if _stands_beside(scene, int(k), parked):
            double = True
        elif not _has_cause(scene, int(k), int(lane[k])):
            stopped = True
    return stopped, double


def _stands_beside(scene: Analysis, k: int, others: np.ndarray) -> bool:
    offset = scene.agents[:, :2] - scene.agents[k, :2]
    cos, sin = scene.agents[k, 4:6]
    along, across = cos * offset[:, 0] + sin * offset[:, 1], cos * offset[:, 1] - sin * offset[:, 0]
    parallel = np.abs(np.cos(scene.yaw - scene.yaw[k])) > 0.85
    return bool((others & parallel & (np.abs(along) < _BESIDE_ALONG) & (np.abs(across) < _BESIDE_ACROSS)).any())


def _has_cause(scene: Analysis, k: int, lane: int) -> bool:
    """Whether a light, a junction or the border within 14 m explains why a vehicle stands."""
    lines, point = scene.lines, int(scene.relations.point[k, lane])
    place, heading = scene.agents[k, :2], lines.headings[lane, point]
    front = place + _STOP_CAUSE * np.array([np.cos(heading), np.sin(heading)])
    if scene.border_distance(front[None])[0] < 0:
        return True
    rest = lines.length[lane] - point * lines.spacing[lane]
    lanes_ahead = [lane] + (lines.next[lane] if rest < _STOP_CAUSE else [])
    if any(lines.signals[other] in (Signal.STOP, Signal.CAUTION) for other in lanes_ahead):
        return True
    return bool(scene.junction_distance(np.stack([place, front])).min() < _STOP_CAUSE)


def _has_corridor(scene: Analysis) -> bool:
    near = scene.relations
    lateral = near.lateral[np.arange(len(near.lane)), near.lane]
    slow = scene.is_type(AgentType.VEHICLE) & (scene.speeds < _CORRIDOR_SPEED) & (near.lane >= 0)
    left, right = (np.flatnonzero(slow & (sign * lateral > _CORRIDOR_LATERAL)) for sign in (1, -1))
    if len(left) < 2 or len(right) < 2:
        return False
    offset = scene.agents[right, None, :2] - scene.agents[None, left, :2]
    heading = scene.yaw[left]
    across = np.cos(heading) * offset[..., 1] - np.sin(heading) * offset[..., 0]
    along = np.abs(np.cos(heading) * offset[..., 0] + np.sin(heading) * offset[..., 1])
    aligned = np.cos(scene.yaw[right, None] - heading[None]) > 0.9
    pairs = aligned & (across < -2.5) & (across > -_CORRIDOR_SPACING) & (along < 25.0)
    return bool(pairs.any(0).sum() >= 2 and pairs.any(1).sum() >= 2)


def _has_cut_in(scene: Analysis) -> bool:
    near, agents = scene.relations, scene.agents
    moving = scene.vehicles & (scene.speeds > _CUT_SPEED)
    everyone = scene.is_type(AgentType.VEHICLE)
    away = scene.junction_distance(agents[:, :2]) >= _JUNCTION_FREE / 2
    for k in np.flatnonzero(moving & away):
        lanes = np.flatnonzero((near.distance[k] < 2.6) & (near.angle[k] < _CUT_ANGLE[1]))
        for lane in lanes:
            heading = float(scene.lines.headings[lane, near.point[k, lane]])
            drift = float(np.sin(scene.yaw[k] - heading))
            lateral = float(near.lateral[k, lane])
            if abs(lateral) < _CUT_OFFSET or drift * lateral > 0 or abs(drift) < np.sin(_CUT_ANGLE[0]):
                continue
            offset = agents[:, :2] - agents[k, :2]
            along = np.cos(heading) * offset[:, 0] + np.sin(heading) * offset[:, 1]
            gap = -along - (agents[:, 6] + agents[k, 6]) / 2
            behind = everyone & (gap > -1.0) & (gap < _CUT_FOLLOWER) & (scene.speeds > _MOVING)
            behind &= (np.cos(scene.yaw - heading) > 0.9) & (near.distance[:, lane] < 1.2)
            if behind.any() and _has_second_lane(scene, int(k), int(lane), heading):
                return True
    return False


def _has_second_lane(scene: Analysis, k: int, lane: int, heading: float) -> bool:
    """Whether a parallel lane of the same direction lies beside ``lane``, where vehicle ``k`` comes from."""
    near, lines = scene.relations, scene.lines
    lateral = near.lateral[k]
    headings = lines.headings[np.arange(len(lines)), near.point[k]]
    side = np.sign(lateral[lane])
    spacing = (lateral[lane] - lateral) * side
    parallel = (np.cos(headings - heading) > 0.95) & (near.distance[k] < 4.5)
    return bool((parallel & (spacing < -2.3) & (spacing > -5.0)).any() or (parallel & (-spacing < -2.3)).any())


def _has_work_zone(scene: Analysis) -> bool:
    objects = scene.is_type(AgentType.STATIC) & (scene.relations.offset < _WORK_DISTANCE)
    return int(objects.sum()) >= _WORK_OBJECTS
