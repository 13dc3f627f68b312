"""Whoever does not drive: parked cars, people on pavements and crossings, cyclists at the edge, cones and barriers."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.scene import AgentType, Signal
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.network import Network
from scjax.synthetic.tracks import Tracks

_BAY = 2.8  # metres of a row that one parked car takes


@dataclasses.dataclass
class Walk:
    """A person along a path: where at time 0 [m], pace [m/s], to the right of the path [m].

    ``lane`` is the lane they follow, or a crossing's number counted from -1 downwards.
    """

    lane: int
    at: float
    pace: float
    right: float


@dataclasses.dataclass
class Bystanders:
    """What stands, and who walks or rides."""

    standing: Actors
    walks: list[Walk]
    rides: list[Walk]
    crossings: list[tuple[np.ndarray, np.ndarray, list[int]]]  # start, end, connectors that cross it


def draw(net: Network, tracks: Tracks, crowd: float, riders: float, rng: np.random.Generator) -> Bystanders:
    """Bystanders of a world: about ``crowd`` people and ``riders`` cyclists for each 100 m of pavement or lane."""
    standing = [_parked_along(net, tracks, rng), _parked_in_lots(net, rng), _works(net, tracks, rng)]
    crossings = _crossings(net)
    walks = []
    for lane in net.walks:
        for _ in range(rng.poisson(crowd * tracks.length[lane] / 100)):
            group = 1 + int(rng.geometric(0.65) - 1)
            at, right = rng.uniform(0, tracks.length[lane]), 0.5 * net.lanes[lane].width + rng.uniform(1.2, 4.5)
            pace = float(rng.choice([-1, 1]) * _pace(rng))
            walks += [Walk(lane, at + rng.normal(0, 0.8), pace, right + 0.9 * k) for k in range(min(group, 4))]
    for number in range(len(crossings)):
        for _ in range(rng.poisson(min(0.8 * crowd, 2.0))):
            walks.append(Walk(-1 - number, rng.uniform(-6, 4), rng.normal(1.35, 0.2), rng.normal(0, 0.5)))
    rides = []
    plain = [k for k, lane in enumerate(net.lanes) if lane.kerb and lane.subtype != "freeway" and lane.height == 0.0]
    for lane in plain:
        for _ in range(rng.poisson(riders * tracks.length[lane] / 100)):
            right = 0.5 * net.lanes[lane].width - rng.uniform(0.2, 0.6)
            rides.append(Walk(lane, rng.uniform(0, tracks.length[lane]), rng.gamma(6.0, 0.7), right))
    return Bystanders(actors.together(standing), walks, rides, crossings)


def at_time(who: Bystanders, tracks: Tracks, lights: np.ndarray, time: float, rng: np.random.Generator) -> Actors:
    """Everybody beside the traffic at ``time`` [s]; nobody steps onto a crossing that has a green light against it."""
    found = [who.standing]
    for people, kind in ((who.walks, AgentType.PEDESTRIAN), (who.rides, AgentType.CYCLIST)):
        along = [walk for walk in people if walk.lane >= 0]
        if along:
            lane = np.array([walk.lane for walk in along])
            pace = np.array([walk.pace for walk in along])
            at = np.mod(np.array([walk.at for walk in along]) + pace * time, tracks.length[lane])
            places, headings = tracks.place(lane, at)
            right = np.array([walk.right for walk in along])
            places = places + right[:, None] * np.stack([np.sin(headings), -np.cos(headings)], -1)
            headings = headings + np.pi * (pace < 0)
            found.append(actors.make(kind, places, headings, np.abs(pace), actors.sizes_of(kind, len(along), rng)))
    across = []
    for walk in who.walks:
        if walk.lane >= 0:
            continue
        start, end, against = who.crossings[-1 - walk.lane]
        width = float(np.hypot(*(end - start)))
        at = (walk.at + walk.pace * time + 6.0) % (width + 12.0) - 6.0
        pace = walk.pace
        if 0.0 < at < width and (lights[against] == Signal.GO).any():
            at, pace = -1.0 - abs(walk.right), 0.15 * pace  # waits at the kerb
        ahead = (end - start) / width
        place = start + at * ahead + walk.right * np.array([-ahead[1], ahead[0]])
        across.append((*place, np.arctan2(ahead[1], ahead[0]), pace))
    if across:
        table = np.array(across)
        sizes = actors.sizes_of(AgentType.PEDESTRIAN, len(table), rng)
        found.append(actors.make(AgentType.PEDESTRIAN, table[:, :2], table[:, 2], table[:, 3], sizes))
    return actors.together(found)


def _pace(rng: np.random.Generator) -> float:
    """Of somebody on a pavement [m/s]: a quarter stands, some stroll, most walk."""
    kind = rng.random()
    return rng.uniform(0, 0.2) if kind < 0.25 else rng.uniform(0.2, 0.9) if kind < 0.45 else rng.normal(1.25, 0.28)


def _parked_along(net: Network, tracks: Tracks, rng: np.random.Generator) -> Actors:
    lanes, at, aside = [], [], []
    for lane in net.parking:
        if tracks.length[lane] < 25 or rng.random() < 0.15:
            continue
        share, place = rng.uniform(0.2, 0.95), 10.0 + rng.uniform(0, 5)
        while place < tracks.length[lane] - 12.0:
            if rng.random() < share:
                lanes.append(lane)
                at.append(place)
                aside.append(0.5 * net.lanes[lane].width + rng.uniform(0.55, 1.2))
            place += rng.uniform(6.2, 7.2)
    if not lanes:
        return _nobody()
    places, headings = tracks.place(np.array(lanes), np.array(at))
    places = places + np.array(aside)[:, None] * np.stack([np.sin(headings), -np.cos(headings)], -1)
    headings = headings + rng.normal(0, 0.02, len(headings))
    return actors.make(AgentType.VEHICLE, places, headings, 0.0, actors.vehicle_sizes(len(places), rng, long=False))


def _parked_in_lots(net: Network, rng: np.random.Generator) -> Actors:
    groups = []
    for lot in net.lots:
        bays = int(lot.length / _BAY)
        full = np.flatnonzero(rng.random(bays) < rng.uniform(0.25, 0.9))
        if not len(full):
            continue
        at = (full - (bays - 1) / 2) * _BAY
        along = np.array([np.cos(lot.along), np.sin(lot.along)])
        headings = lot.heading + np.pi * (rng.random(len(full)) < 0.25) + rng.normal(0, 0.02, len(full))
        places = lot.middle + at[:, None] * along + rng.normal(0, 0.06, (len(full), 2))
        groups.append(
            actors.make(AgentType.VEHICLE, places, headings, 0.0, actors.vehicle_sizes(len(full), rng, long=False))
        )
    return actors.together(groups) if groups else _nobody()


def _works(net: Network, tracks: Tracks, rng: np.random.Generator) -> Actors:
    """At times a row of cones, or barriers, along the edge of a road."""
    edges = [k for k, lane in enumerate(net.lanes) if lane.kerb and tracks.length[k] > 30 and k not in net.parking]
    if not edges or rng.random() > 0.15:
        return _nobody()
    lane = int(rng.choice(edges))
    count = int(rng.integers(4, 10))
    at = rng.uniform(5, tracks.length[lane] - 20) + rng.uniform(2.5, 4.0) * np.arange(count)
    at = at[at < tracks.length[lane] - 3]
    places, headings = tracks.place(np.full(len(at), lane), at)
    right = 0.5 * net.lanes[lane].width + rng.uniform(0.2, 0.7)
    places = places + right * np.stack([np.sin(headings), -np.cos(headings)], -1)
    kind = actors.CONE if rng.random() < 0.6 else actors.BARRIER
    return actors.make(AgentType.STATIC, places, headings, 0.0, kind)


def _crossings(net: Network) -> list[tuple[np.ndarray, np.ndarray, list[int]]]:
    """Across every arm of junctions with pavements, in front of its stop line; both ways."""
    found = []
    walked = {k for k in net.walks}
    for junction in net.junctions:
        if junction.kind in ("merge", "driveway"):
            continue
        for a, arm in enumerate(junction.arms):
            lanes = [lane for lane, _ in arm.inbound] + arm.outbound
            if not walked & set(lanes):
                continue
            ahead = np.array([np.cos(arm.angle), np.sin(arm.angle)])
            left = np.array([-ahead[1], ahead[0]])
            ends = [net.lanes[lane].points[-1] for lane, _ in arm.inbound]
            ends += [net.lanes[lane].points[0] for lane in arm.outbound]
            reach = (np.array(ends) - junction.centre) @ left
            place = junction.centre + (((np.array(ends) - junction.centre) @ ahead).min() - 1.8) * ahead
            first, last = place + (reach.min() - 2.6) * left, place + (reach.max() + 2.6) * left
            against = [k for k in junction.connectors if net.lanes[k].arm == a and net.lanes[k].turn == "through"]
            found += [(first, last, against), (last, first, against)]
    return found


def _nobody() -> Actors:
    return actors.make(AgentType.VEHICLE, np.zeros((0, 2)), 0.0, 0.0, np.zeros((0, 3)))
