"""Traffic for a made-up map: cars at constant speeds, queues at red lights, people beside and across the road."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from scjax.data.procedural_roads import Movement, RoadMap
from scjax.data.synthetic.curves import arc_of, length_of
from scjax.data.synthetic.network import MPS_OF_MPH

STEPS, DT = 91, 0.1
TIMES = np.arange(STEPS) * DT
_SOME = slice(None, None, 2)  # the steps at which clearances are checked
_SPREAD = np.linspace(-0.4, 0.4, 5)
_NEAR = 45.0  # metres beyond which nothing is checked; no headway is longer
_SIZES = {  # mean and spread of length, width, height in metres
    "vehicle": ((4.7, 2.05, 1.65), (0.3, 0.1, 0.15)),
    "truck": ((8.5, 2.55, 3.2), (1.2, 0.1, 0.3)),
    "pedestrian": ((0.9, 0.85, 1.72), (0.08, 0.08, 0.1)),
    "cyclist": ((1.8, 0.85, 1.75), (0.1, 0.05, 0.08)),
    "traffic_cone": ((0.4, 0.4, 0.75), (0.03, 0.03, 0.05)),
}


@dataclasses.dataclass
class Track:
    """One object over all steps, in the map's frame: metres, radians, m/s."""

    type: str
    size: np.ndarray  # length, width, height
    places: np.ndarray  # [T, 2]
    headings: np.ndarray  # [T]
    speeds: np.ndarray  # [T]
    valid: np.ndarray  # [T]

    @functools.cached_property
    def discs(self) -> np.ndarray:
        """Centres of the discs that cover the box at some of the steps, [5, T / 2, 2]."""
        ahead = np.stack([np.cos(self.headings), np.sin(self.headings)], -1)[_SOME]
        return self.places[_SOME] + _SPREAD[:, None, None] * self.size[0] * ahead


def make_traffic(road: RoadMap, phase: set[Movement] | None, rng: np.random.Generator) -> list[Track]:
    """Tracks, the recording car first; ``phase`` may drive (all, if None) and others wait. Every further candidate must
    keep clear of all before it, at all times.
    """
    moving, waiting = _paths(road, phase)
    limits = [rng.uniform(0.75, 1.0) * lane.speed_limit * MPS_OF_MPH for lane in road.lanes]
    vehicles = int(rng.integers(4, 40 if road.kind == "merge" else 32))
    tracks = [_ego(road, moving, waiting, limits, rng)]
    for lane in waiting:
        for slot, gap in enumerate(rng.uniform(1.6, 3.0, rng.integers(0, 5))):
            arriving = slot > 0 and rng.random() < 0.3
            _admit(tracks, _queued(road, lane, slot, gap, limits[lane], arriving, rng))
    for _ in range(3 * vehicles):
        if len(tracks) < vehicles:
            lanes = moving[rng.integers(len(moving))]
            speed = _speed(road, lanes, limits) * rng.uniform(0.95, 1.02)
            path = _points(road, lanes)
            start = rng.uniform(-40, length_of(path))
            _admit(tracks, _driver(path, start + speed * TIMES, rng))
    if road.kind != "merge":
        kerbs = [i for i, lane in enumerate(road.lanes) if lane.right is None and lane.turn is None]
        for _ in range(rng.integers(0, 8) if rng.random() < 0.5 else 0):
            path = _points(road, [int(rng.choice(kerbs))])
            at = np.full(STEPS, rng.uniform(3, length_of(path) - 3))
            _admit(tracks, _driver(path, at, rng, right=rng.uniform(2.7, 3.0)))
        for _ in range(rng.poisson(4) if rng.random() < 0.6 else 0):
            _admit(tracks, _walker(road, kerbs, rng))
        for _ in range(rng.poisson(1.0)):
            path = _points(road, [int(rng.choice(kerbs))])
            at = rng.uniform(0, length_of(path)) + rng.uniform(2.5, 6) * TIMES
            _admit(tracks, _driver(path, at, rng, kind="cyclist", right=1.5))
        if rng.random() < 0.1:
            path = _points(road, [int(rng.choice(kerbs))])
            for at in rng.uniform(5, length_of(path) - 20) + 3.0 * np.arange(rng.integers(3, 7)):
                _admit(tracks, _driver(path, np.full(STEPS, at), rng, kind="traffic_cone", right=2.1))
    return tracks


def _paths(road: RoadMap, phase: set[Movement] | None) -> tuple[list[list[int]], list[int]]:
    """Lane chains that traffic drives along in this phase, and the lanes on which it waits."""
    follows = {after for lane in road.lanes for after in lane.successors}
    moving, waiting = [], []
    for entry in range(len(road.lanes)):
        if road.lanes[entry].turn is not None:
            continue
        if entry in follows:  # its own traffic, besides that which comes from upstream
            moving.append(_onward(road, [entry], phase))
            continue
        options = [i for i in road.lanes[entry].successors if _may_go(road, i, phase)]
        moving += [_onward(road, [entry, i], phase) for i in options for _ in range(2)]
        if not options and road.lanes[entry].successors:
            waiting.append(entry)
        elif not options:
            moving.append([entry])
    return [path for path in moving if path], waiting


def _onward(road: RoadMap, path: list[int], phase: set[Movement] | None) -> list[int]:
    """``path`` followed down to the edge of the map; empty where it runs into a red light."""
    while road.lanes[path[-1]].successors:
        options = [i for i in road.lanes[path[-1]].successors if _may_go(road, i, phase)]
        if not options:
            return []
        path = [*path, options[0]]
    return path


def _may_go(road: RoadMap, lane: int, phase: set[Movement] | None) -> bool:
    turn = road.lanes[lane].turn
    return turn is None or phase is None or (road.lanes[lane].arm, turn) in phase


def _speed(road: RoadMap, lanes: list[int], limits: list[float]) -> float:
    """One speed for all on a lane, so that headways last; whoever shares it with turning cars is slow as well."""
    ahead = {road.lanes[after].turn for after in road.lanes[lanes[0]].successors}
    turning = bool({"left", "right"} & ({road.lanes[i].turn for i in lanes} | ahead))
    return min(limits[lanes[0]], 6.5 if turning else np.inf)


def _ego(road: RoadMap, moving: list, waiting: list, limits: list[float], rng: np.random.Generator) -> Track:
    if waiting and rng.random() < 0.2:
        return _queued(road, int(rng.choice(waiting)), 0, 2.0, 0.0, False, rng)
    # Through the middle of the map, so that there is something to see around every pose.
    reach = [np.hypot(*_points(road, lanes).T).min() for lanes in moving]
    lanes = moving[int(rng.choice(np.flatnonzero(np.array(reach) < min(reach) + 12)))]
    path, speed = _points(road, lanes), _speed(road, lanes, limits)
    nearest = arc_of(path)[np.hypot(*path.T).argmin()]
    start = nearest - speed * TIMES[-1] / 2 + rng.uniform(-10, 10)
    start = np.clip(start, 0, max(0.0, length_of(path) - speed * TIMES[-1]))
    return _driver(path, start + speed * TIMES, rng, truck=False)


def _queued(road, lane: int, slot: int, gap: float, speed: float, arriving: bool, rng) -> Track:
    """A car in slot 0, 1, ... behind the stop line of ``lane``; ``arriving``: it brakes from ``speed`` to a stop."""
    path = _points(road, [lane])
    stop = length_of(path) - 3.5 - slot * (4.9 + gap)
    left = np.clip(6.0 - TIMES, 0, None)  # seconds until it stands
    return _driver(path, stop - (0.5 * speed / 6.0 * left**2 if arriving else 0 * left), rng, truck=False)


def _driver(path: np.ndarray, at: np.ndarray, rng, *, kind="vehicle", right: float | None = None, truck=None) -> Track:
    """Whoever is ``at`` so many metres along ``path`` at each step; not there before its start and behind its end."""
    arc, along = arc_of(path), np.gradient(path, axis=0)
    heading = np.interp(at, arc, np.unwrap(np.arctan2(along[:, 1], along[:, 0])))
    side = rng.normal(0, 0.12) if right is None else -right
    places = np.stack([np.interp(at, arc, path[:, d]) for d in (0, 1)], -1)
    places = places + side * np.stack([-np.sin(heading), np.cos(heading)], -1)
    large = kind == "vehicle" and (rng.random() < 0.06 if truck is None else truck)
    speed = np.maximum(np.gradient(at, DT), 0)
    return Track(kind, _size("truck" if large else kind, rng), places, heading, speed, (at >= 0) & (at <= arc[-1]))


def _walker(road: RoadMap, kerbs: list[int], rng: np.random.Generator) -> Track:
    """A pedestrian along a pavement, or, at an intersection, often across an arm in front of the stop line."""
    pace, back = rng.uniform(0.9, 1.7) * (rng.random() > 0.15), int(rng.choice([-1, 1]))
    if road.arms and rng.random() < 0.5:
        direction, stop = road.arms[rng.integers(len(road.arms))]
        ahead = np.array([np.cos(direction), np.sin(direction)])
        across = np.arange(-14, 14.1, 1.0)[:, None] * np.array([-ahead[1], ahead[0]])
        path, right = (stop - 2.5 + rng.normal(0, 0.4)) * ahead + across, 0.0
    else:
        path, right = _points(road, [int(rng.choice(kerbs))]), back * rng.uniform(4.2, 6.0)
    at = rng.uniform(0, length_of(path)) + pace * TIMES
    return _driver(path[::back], at, rng, kind="pedestrian", right=right)


def _admit(tracks: list[Track], new: Track) -> None:
    """Adds ``new`` unless it comes too close to another one, or, on the same course, too close for its speed."""
    ahead = np.stack([np.cos(new.headings), np.sin(new.headings)], -1)[_SOME]
    for other in tracks:
        both = (new.valid & other.valid)[_SOME]
        offset = (other.places - new.places)[_SOME]
        near = both & (np.square(offset).sum(-1) < _NEAR**2)
        if not near.any():
            continue
        clear = _disc_radius(new) + _disc_radius(other) + 0.2
        gap = other.discs[None, :, near] - new.discs[:, None, near]
        if np.square(gap).sum(-1).min() < clear**2:
            return
        along = np.abs((offset * ahead).sum(-1))
        aside = np.abs(offset[:, 1] * ahead[:, 0] - offset[:, 0] * ahead[:, 1])
        course = np.cos((other.headings - new.headings)[_SOME]) > 0.8
        wanted = (new.size[0] + other.size[0]) / 2 + 1.2 + 0.7 * np.maximum(new.speeds, other.speeds)[_SOME]
        if (near & course & (aside < 1.2) & (along < wanted)).any():
            return
    if new.valid.any():
        tracks.append(new)


def _disc_radius(track: Track) -> float:
    return float(np.hypot(track.size[0] / 10, track.size[1] / 2))


def _size(kind: str, rng: np.random.Generator) -> np.ndarray:
    mean, spread = _SIZES[kind]
    return np.array(mean) + np.clip(rng.normal(size=3), -2, 2) * np.array(spread)


def _points(road: RoadMap, lanes: list[int]) -> np.ndarray:
    return np.concatenate([road.lanes[lanes[0]].points, *(road.lanes[i].points[1:] for i in lanes[1:])])
