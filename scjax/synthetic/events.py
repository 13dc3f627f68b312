"""Rare events, staged in otherwise ordinary traffic; each leaves a label behind."""

from __future__ import annotations

import dataclasses

import numpy as np

from scjax.scene import AgentType
from scjax.synthetic import actors
from scjax.synthetic.actors import Actors
from scjax.synthetic.network import Network
from scjax.synthetic.tracks import Tracks
from scjax.synthetic.traffic import Fleet

_STANDS = 1e-3  # pace of a vehicle that will not move
_JAM = 9  # vehicles of a lane in a jam
_CLEAR = 22.0  # metres of road before a stopped vehicle, and from a junction
_MIDDLE = 75.0  # metres from the origin within which events happen


@dataclasses.dataclass(frozen=True)
class Staged:
    """An event to be: its kind, the lane where it happens and the place along it [m]."""

    kind: str
    lane: int
    at: float


def stage(kind: str, net: Network, tracks: Tracks, rng: np.random.Generator) -> Staged | None:
    """A place for an event of ``kind``; None where the network has none."""
    options = [
        k
        for k, lane in enumerate(net.lanes)
        if lane.junction < 0 and not lane.centre and tracks.length[k] > 2 * _CLEAR + 15 and _suits(kind, net, k)
    ]
    rng.shuffle(options)
    for lane in options:
        for at in rng.uniform(_CLEAR, tracks.length[lane] - _CLEAR, 3):
            place, _ = tracks.place(np.array([lane]), np.array([at]))
            if np.hypot(*place[0]) < _MIDDLE:
                return Staged(kind, int(lane), float(at))
    return None


def obstruct(staged: Staged, net: Network, tracks: Tracks, fleet: Fleet, rng: np.random.Generator) -> Fleet:
    """The fleet with what must be there before traffic runs: a vehicle that stands, or a jam on all lanes abreast."""
    if staged.kind == "emergency corridor":
        lanes = _abreast(net, staged.lane)
        kept = ~np.isin(fleet.lane, lanes)
        lane = np.repeat(lanes, _JAM)
        at = staged.at + (np.tile(np.arange(_JAM), len(lanes)) - _JAM // 2) * rng.uniform(8.5, 11.0)
        inside = (at > 4.0) & (at < tracks.length[lane] - 4.0)
        lane, at = lane[inside], at[inside] + rng.uniform(-0.8, 0.8, inside.sum())
        return _joined(fleet, kept, tracks, lane, at, rng.uniform(0.02, 0.08, len(lane)), 0.0, rng)
    if staged.kind not in ("stopped vehicle in lane", "double parking"):
        return fleet
    kept = (fleet.lane != staged.lane) | (np.abs(fleet.at - staged.at) > 12.0)
    aside = -(0.5 * net.lanes[staged.lane].width - 0.9) if staged.kind == "double parking" else rng.normal(0, 0.15)
    return _joined(
        fleet, kept, tracks, np.array([staged.lane]), np.array([staged.at]), np.array([_STANDS]), aside, rng
    )  # fmt: skip


def _joined(
    fleet: Fleet, kept: np.ndarray, tracks: Tracks, lane: np.ndarray, at: np.ndarray, pace: np.ndarray, aside: float,
    rng: np.random.Generator,
) -> Fleet:  # fmt: skip
    """Some of a fleet, and vehicles that hardly move."""
    new = {
        "lane": lane, "at": at, "speed": np.zeros(len(lane)), "after": tracks.successors[lane, 0],
        "holds": np.full(len(lane), -1), "sizes": actors.vehicle_sizes(len(lane), rng, long=False), "pace": pace,
        "aside": np.full(len(lane), aside),
    }  # fmt: skip
    return Fleet(**{name: np.concatenate([getattr(fleet, name)[kept], value]) for name, value in new.items()})


def happen(
    staged: Staged, net: Network, tracks: Tracks, scene: Actors, rng: np.random.Generator
) -> tuple[Actors, int, str] | None:
    """A moment's scene with the event, the agent that it is about, and what it has become; None without room for it."""
    if staged.kind in ("stopped vehicle in lane", "double parking"):
        place, _ = tracks.place(np.array([staged.lane]), np.array([staged.at]))
        near = np.hypot(*(scene.places - place).T)
        there = np.flatnonzero((scene.lane == staged.lane) & (scene.speeds < 0.1) & (near < 2.0))
        if not len(there) or _has_leader(scene, int(there[0])):
            return None
        kind, about = staged.kind, int(there[0])
        if kind == "double parking":
            scene = _parked_beside(scene, about, rng)
            kind = kind if _has_parked_beside(scene, about) else "stopped vehicle in lane"
        return scene, about, kind
    if staged.kind in ("emergency corridor", "cut-in"):
        act = _corridor if staged.kind == "emergency corridor" else _cut_in
        acted = act(staged, net, tracks, scene, rng)
        return None if acted is None else (*acted, staged.kind)
    places, headings = tracks.place(np.array([staged.lane]), np.array([staged.at]))
    if staged.kind == "wrong-way driver":
        new = actors.make(
            AgentType.VEHICLE, places, headings + np.pi, rng.uniform(4, 12), actors.vehicle_sizes(1, rng, long=False),
            lane=staged.lane,
        )  # fmt: skip
        margin = 6.0
    else:
        across = headings + rng.choice([-1, 1]) * np.pi / 2 + rng.normal(0, 0.2)
        places = places + rng.uniform(-0.8, 0.8) * np.stack([-np.sin(headings), np.cos(headings)], -1)
        size = actors.sizes_of(AgentType.PEDESTRIAN, 1, rng)
        new = actors.make(AgentType.PEDESTRIAN, places, across, rng.uniform(1.0, 2.2), size, lane=staged.lane)
        margin = 3.0
    if net.lanes[staged.lane].height != 0.0:
        return None
    # Whoever is in the way was not there.
    gone = np.hypot(*(scene.places - places).T) < margin
    scene = actors.together([scene.select(~gone), new])
    return scene, len(scene) - 1, staged.kind


def shows(kind: str, net: Network, scene: Actors, about: int, ego: int) -> bool:
    """Whether the surroundings of ``ego`` show all of an event: a corridor needs traffic on both its sides."""
    if kind != "emergency corridor":
        return True
    lanes = _abreast(net, int(scene.lane[about]))
    near = np.abs(scene.places - scene.places[ego]).max(-1) < 22.0
    near[[about, ego]] = False
    left, right = near & (scene.lane == lanes[0]), near & np.isin(scene.lane, lanes[1:2])
    return bool(left.sum() >= 2 and right.sum() >= 2)


def _has_leader(scene: Actors, who: int) -> bool:
    """Whether somebody ahead explains why a vehicle stands."""
    to, heading = scene.places - scene.places[who], scene.headings[who]
    along = np.cos(heading) * to[:, 0] + np.sin(heading) * to[:, 1]
    left = np.cos(heading) * to[:, 1] - np.sin(heading) * to[:, 0]
    return bool(((along > 1.0) & (along < 22.0) & (np.abs(left) < 1.8)).any())


def _has_parked_beside(scene: Actors, who: int) -> bool:
    to = scene.places - scene.places[who]
    heading = scene.headings[who]
    right = np.sin(heading) * to[:, 0] - np.cos(heading) * to[:, 1]
    parked = (scene.types == AgentType.VEHICLE) & (scene.lane < 0) & (scene.speeds < 0.1)
    return bool((parked & (np.hypot(*to.T) < 8.0) & (right > 1.0)).any())


def _parked_beside(scene: Actors, who: int, rng: np.random.Generator) -> Actors:
    """With a vehicle parked at the kerb beside one that stands in the lane, if there is room for it."""
    heading = scene.headings[who]
    right = np.array([np.sin(heading), -np.cos(heading)])
    place = scene.places[who] + rng.uniform(-2, 2) * np.array([-right[1], right[0]]) + rng.uniform(2.3, 2.6) * right
    box = actors.vehicle_sizes(1, rng, long=False)
    together = actors.together([scene, actors.make(AgentType.VEHICLE, place[None], heading, 0.0, box)])
    return scene if (actors.overlapping(together)[:, 1] == len(scene)).any() else together


def _suits(kind: str, net: Network, k: int) -> bool:
    lane = net.lanes[k]
    if lane.height != 0.0:
        return False
    freeway = lane.subtype == "freeway"
    if kind == "double parking":
        return k in net.parking and lane.left is None and not freeway
    if kind == "jaywalker":
        return not freeway
    if kind == "emergency corridor":
        return lane.left is not None and lane.right is None
    if kind == "cut-in":
        return lane.left is not None or lane.right is not None
    return True


def _abreast(net: Network, lane: int) -> list[int]:
    """All lanes side by side with ``lane``, from the left."""
    while (left := net.lanes[lane].left) is not None:
        lane = left
    found = [lane]
    while (right := net.lanes[found[-1]].right) is not None:
        found.append(right)
    return found


def _corridor(staged, net, tracks, scene: Actors, rng) -> tuple[Actors, int] | None:
    """Those in the leftmost lane keep left, all others right; an ambulance comes through between."""
    lanes = _abreast(net, staged.lane)
    queued = np.isin(scene.lane, lanes) & (scene.types == AgentType.VEHICLE)
    if (scene.lane[queued] == lanes[0]).sum() < 2 or (scene.lane[queued] != lanes[0]).sum() < 2:
        return None
    left = np.where(scene.lane == lanes[0], 0.85, -0.75) * queued
    normal = np.stack([-np.sin(scene.headings), np.cos(scene.headings)], -1)
    places = scene.places + left[:, None] * normal
    border, heading = tracks.place(np.array([lanes[0]]), np.array([staged.at]))
    right = 0.5 * net.lanes[lanes[0]].width * np.stack([np.sin(heading), -np.cos(heading)], -1)
    ambulance = actors.make(
        AgentType.VEHICLE, border + right, heading, rng.uniform(3, 8), (5.6, 2.0, 2.6), lane=lanes[0]
    )
    moved = Actors(scene.types, places, scene.headings, scene.speeds, scene.sizes, scene.level, scene.lane)
    together = actors.together([moved, ambulance])
    # Nobody stays in the ambulance's way, nor where the others have moved to.
    first, second = actors.overlapping(together).T
    gone = np.where(second == len(together) - 1, first, second)
    keep = np.setdiff1d(np.arange(len(together)), gone)
    return together.select(keep), len(keep) - 1


def _cut_in(staged, net, tracks, scene: Actors, rng) -> tuple[Actors, int] | None:
    """Somebody halfway into the next lane, shortly before a vehicle that drives there."""
    lane = net.lanes[staged.lane]
    other = lane.left if lane.left is not None else lane.right
    assert other is not None  # only lanes with a neighbour suit
    sign = 1.0 if lane.left is not None else -1.0
    behind = np.flatnonzero((scene.lane == other) & (scene.speeds > 3.0) & (scene.types == AgentType.VEHICLE))
    rng.shuffle(behind)
    for follower in behind:
        ahead = np.array([np.cos(scene.headings[follower]), np.sin(scene.headings[follower])])
        left = np.array([-ahead[1], ahead[0]])
        box = actors.vehicle_sizes(1, rng, long=False)
        gap = (scene.sizes[follower, 0] + box[0, 0]) / 2 + rng.uniform(3.0, 7.0)
        place = scene.places[follower] + gap * ahead - sign * rng.uniform(0.9, 1.6) * left
        near = [np.hypot(*(place - junction.centre)) < junction.radius + 16.0 for junction in net.junctions]
        if np.hypot(*place) > _MIDDLE or any(near):
            continue
        heading = scene.headings[follower] + sign * rng.uniform(0.06, 0.16)
        new = actors.make(
            AgentType.VEHICLE, place[None], heading, scene.speeds[follower] * rng.uniform(0.85, 1.05), box,
            lane=staged.lane,
        )  # fmt: skip
        together = actors.together([scene, new])
        pairs = actors.overlapping(together, 0.4)
        in_way = np.unique(pairs[pairs[:, 1] == len(together) - 1, 0])
        if follower in in_way:
            continue
        keep = np.setdiff1d(np.arange(len(together)), in_way)
        return together.select(keep), len(keep) - 1
    return None
