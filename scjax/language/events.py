"""Rare events, read off one moment: who drives against the traffic, stands where nobody should, or pushes in.

A moment cannot show everything. The rules ask for a clear case, away from junctions, where queues and turns explain
what would be an event elsewhere.
"""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np

from scjax.language.intersections import Intersection
from scjax.language.road import Road, wrapped
from scjax.scene import AgentType, Scene

Event = Literal[
    "wrong-way driver", "jaywalker", "stopped vehicle in lane", "double parking", "emergency corridor", "cut-in"
]

_MARGIN = 25.0  # metres from the ego within which an event is seen as a whole
_IN_LANE = 1.3  # metres from a centreline
_WRONG = (np.deg2rad(150.0), np.deg2rad(60.0), 2.6)  # against a lane; with one, and how near that may be [m]
_MOVES, _STANDS = 1.0, 0.1  # m/s
_WALKS_INTO = (1.6, np.deg2rad(40.0), 0.5)  # metres from a centreline, radians off its direction, m/s
_JUNCTION = 18.0  # metres of road around a fork, a merge or an intersection in which nothing is an event
_SHARP = (0.6, 1 / 40)  # radians of a lane, and radians a metre where it is a turn and no bend
_STOP = 8.0  # metres from an intersection in which vehicles wait
_WINDOW = 32.0  # metres
_LEADER = 14.0  # metres ahead in which another vehicle explains why one stands
_BESIDE = (0.5, 9.0, 1.6)  # metres off the middle of a lane; to a parked vehicle; that vehicle off any lane
_CORRIDOR = (0.35, 3.5, 2)  # metres off the middle, m/s at most, vehicles of each lane
_CUT_IN = (0.04, 0.3, 2.2, 14.0)  # radians towards the next lane at least and at most; metres from it; gap behind [m]
_NEXT_LANE = (2.4, 4.6)  # metres between the middles of lanes side by side


@dataclasses.dataclass(frozen=True)
class _Seen:
    """Agents without the ego: ``distance`` [m] and ``turn`` [rad] to every lane, ``left`` and ``off`` to the next."""

    places: np.ndarray
    headings: np.ndarray
    speeds: np.ndarray
    lengths: np.ndarray
    vehicle: np.ndarray
    walker: np.ndarray
    inside: np.ndarray
    lane: np.ndarray
    distance: np.ndarray
    turn: np.ndarray
    left: np.ndarray
    off: np.ndarray


def find_events(scene: Scene, road: Road, intersections: list[Intersection]) -> tuple[Event, ...]:
    """Events of one scene without padding, whose agent 0 is the ego; each kind once."""
    if not len(road) or len(scene.agents) < 2:
        return ()
    seen = _look(scene, road)
    calm = seen.inside & ~_near_junction(seen.places, road, intersections)
    standing = _standing(seen, calm, scene)
    double = _double_parked(seen, standing)
    found: dict[Event, bool] = {
        "wrong-way driver": bool((_wrong_way(seen) & calm).any()),
        "jaywalker": bool((_jaywalks(seen) & calm).any()),
        "stopped vehicle in lane": bool((standing & ~double).any()),
        "double parking": bool(double.any()),
        "emergency corridor": _has_corridor(seen),
        "cut-in": bool((_cuts_in(seen, road, scene) & calm).any()),
    }
    return tuple(event for event, there in found.items() if there)


def _look(scene: Scene, road: Road) -> _Seen:
    agents, types = np.asarray(scene.agents, np.float64)[1:], np.asarray(scene.agent_types)[1:]
    places, headings = agents[:, :2], np.arctan2(agents[:, 5], agents[:, 4])
    distance = np.linalg.norm(places[:, None, None] - road.line[None], axis=-1)
    # Of overlapping lanes the one that runs the agent's way.
    nearest = np.minimum(distance.argmin(-1), road.chord.shape[1] - 1)
    turn = np.abs(wrapped(headings[:, None] - road.chord[np.arange(len(road)), nearest]))
    lane = (distance.min(-1) + 0.5 * turn).argmin(-1)
    rows = np.arange(len(agents))
    point = distance[rows, lane].argmin(-1)
    direction = road.chord[lane, np.minimum(point, road.chord.shape[1] - 1)]
    apart = places - road.line[lane, point]
    left = np.cos(direction) * apart[:, 1] - np.sin(direction) * apart[:, 0]
    return _Seen(
        places, headings, agents[:, 3], agents[:, 6], types == AgentType.VEHICLE, types == AgentType.PEDESTRIAN,
        np.abs(places).max(-1) < _MARGIN, lane, distance.min(-1), turn, left, wrapped(headings - direction),
    )  # fmt: skip


def _near_junction(places: np.ndarray, road: Road, intersections: list[Intersection]) -> np.ndarray:
    spots = [road.line[k, -1] for k in range(len(road)) if len(road.successors[k]) > 1]
    spots += [road.line[k, 0] for k in range(len(road)) if len(road.predecessors[k]) > 1]
    near = np.zeros(len(places), bool)
    if spots:
        near |= (np.linalg.norm(places[:, None] - np.array(spots)[None], axis=-1) < _JUNCTION).any(1)
    # Turns whose approach has a lane of its own start at no fork.
    tight = np.abs(road.bend) > _SHARP[1] * road.length[:, None] / (road.line.shape[1] - 1)
    sharp = (np.abs(road.bend).sum(1) > _SHARP[0])[:, None] & tight
    if sharp.any():
        bends = road.line[:, 1:-1][sharp]
        near |= (np.linalg.norm(places[:, None] - bends[None], axis=-1) < _JUNCTION).any(1)
    for item in intersections:
        near |= np.linalg.norm(places - item.centre, axis=-1) < item.radius + _STOP
    return near


def _wrong_way(seen: _Seen) -> np.ndarray:
    """On a lane, moving against it, with no lane of its own direction near."""
    against, with_it, reach = _WRONG
    on_it = (seen.distance < _IN_LANE) & (seen.turn > against)
    wrong = on_it.any(1) & ~((seen.distance < reach) & (seen.turn < with_it)).any(1)
    return wrong & seen.vehicle & (seen.speeds > _MOVES)


def _jaywalks(seen: _Seen) -> np.ndarray:
    near, across, pace = _WALKS_INTO
    off = np.minimum(np.abs(seen.off), np.pi - np.abs(seen.off))
    return seen.walker & (np.abs(seen.left) < near) & (off > across) & (seen.speeds > pace)


def _standing(seen: _Seen, calm: np.ndarray, scene: Scene) -> np.ndarray:
    """Vehicles that stand in a lane without anybody in front."""
    stands = seen.vehicle & calm & (seen.speeds < _STANDS) & (np.abs(seen.left) < _IN_LANE) & (np.abs(seen.off) < 0.3)
    everyone = np.asarray(scene.agents, np.float64)
    for k in np.flatnonzero(stands):
        cos, sin = np.cos(seen.headings[k]), np.sin(seen.headings[k])
        to = everyone[:, :2] - seen.places[k]
        along, left = cos * to[:, 0] + sin * to[:, 1], cos * to[:, 1] - sin * to[:, 0]
        gap = along - (everyone[:, 6] + seen.lengths[k]) / 2
        view = np.abs(seen.places[k] + _LEADER * np.array([cos, sin])).max() < _WINDOW
        stands[k] = view and not ((along > 0.5) & (gap < _LEADER) & (np.abs(left) < 1.6)).any()
    return stands


def _double_parked(seen: _Seen, standing: np.ndarray) -> np.ndarray:
    """Standing vehicles at the edge of their lane, beside one that is parked."""
    off, reach, beside = _BESIDE
    parked = seen.vehicle & (seen.speeds < _STANDS) & (np.abs(seen.left) > beside) & (np.abs(np.sin(seen.off)) < 0.3)
    found = np.zeros(len(standing), bool)
    for k in np.flatnonzero(standing & (np.abs(seen.left) > off)):
        near = parked & (np.linalg.norm(seen.places - seen.places[k], axis=-1) < reach)
        found[k] = (near & (seen.left * seen.left[k] > 0)).any()
    return found


def _has_corridor(seen: _Seen) -> bool:
    """Two lanes of slow traffic, side by side, each keeping to its outer edge."""
    off, slow, least = _CORRIDOR
    queued = seen.vehicle & (seen.speeds < slow) & (np.abs(seen.off) < 0.3) & (np.abs(seen.left) < 1.5)
    outward: dict[int, list[float]] = {}
    for lane in np.unique(seen.lane[queued]):
        outward[int(lane)] = seen.left[queued & (seen.lane == lane)].tolist()
    for lane, offsets in outward.items():
        for other, others in outward.items():
            if lane == other or len(offsets) < least or len(others) < least:
                continue
            if not (np.mean(offsets) > off and np.mean(others) < -off):
                continue
            mine, theirs = (seen.places[queued & (seen.lane == k)] for k in (lane, other))
            heading = seen.headings[queued & (seen.lane == lane)][0]
            aside = np.cos(heading) * (theirs - mine[0])[:, 1] - np.sin(heading) * (theirs - mine[0])[:, 0]
            if -7.5 < np.median(aside) < -3.0:
                return True
    return False


def _cuts_in(seen: _Seen, road: Road, scene: Scene) -> np.ndarray:
    """Moving vehicles on their way into the next lane, shortly before somebody who drives there."""
    least, most, reach, gap = _CUT_IN
    everyone = np.asarray(scene.agents, np.float64)
    vehicles = np.asarray(scene.agent_types) == AgentType.VEHICLE
    found = np.zeros(len(seen.speeds), bool)
    leaning = seen.vehicle & (seen.speeds > 2.0) & (np.abs(seen.off) > least) & (np.abs(seen.off) < most)
    for k in np.flatnonzero(leaning & (np.abs(seen.left) < _NEXT_LANE[1] / 2 + 0.3)):
        direction = seen.headings[k] - seen.off[k]
        ahead, side = np.array([np.cos(direction), np.sin(direction)]), np.sign(seen.off[k])
        normal = np.array([-ahead[1], ahead[0]])
        # The middle of the lane that it leans to: its own one, if it has come so far, or the next.
        gaps = (road.line - seen.places[k]) @ normal * side
        along = np.abs((road.line - seen.places[k]) @ ahead)
        here = along.argmin(1)
        rows = np.arange(len(road))
        parallel = np.abs(wrapped(road.chord[rows, np.minimum(here, road.chord.shape[1] - 1)] - direction)) < 0.2
        target = gaps[rows, here]
        good = parallel & (along[rows, here] < 2.0) & (target > 0.4) & (target < reach)
        if not good.any():
            continue
        middle = target[good].min()
        to = everyone[:, :2] - seen.places[k]
        back = -(to @ ahead) - (everyone[:, 6] + seen.lengths[k]) / 2
        sideways = np.abs((to @ normal) * side - middle)
        runs = np.cos(np.arctan2(everyone[:, 5], everyone[:, 4]) - direction) > 0.9
        found[k] = (vehicles & runs & (everyone[:, 3] > 1.5) & (back > 0.5) & (back < gap) & (sideways < 1.1)).any()
    return found
