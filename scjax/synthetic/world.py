"""A synthetic world: a map, traffic at some moments, the places worth cutting scenes at, and what they are labelled.

World k of a seed depends on the two numbers alone. Its scenes go the way of recorded ones: ``Log`` -> records.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence

import numpy as np

from scjax.language.events import EVENTS
from scjax.scene import AgentType, LaneNeighbor, Log, LogMetadata, MapLane, Signal
from scjax.synthetic import actors, bystanders, domains, events
from scjax.synthetic.actors import Actors
from scjax.synthetic.ground import Ground
from scjax.synthetic.network import Network
from scjax.synthetic.signals import Timing
from scjax.synthetic.tracks import Tracks, track
from scjax.synthetic.traffic import Fleet, Simulation, fill

VERSION = 1  # raised whenever a world of the same numbers comes out different
MOMENTS = 3
APART = 9.0  # seconds between moments
CROPS = 15  # a world at most
_WARM_UP = 22.0  # seconds of traffic before the first moment
_SPACING = 14.0  # metres between the egos of one world, over all moments
_BUSY = 30.0  # metres from a junction
_ELSEWHERE = 0.2  # share of the others that are egos
_VIEW = 78.0  # metres from the middle of the map within which egos drive


@dataclasses.dataclass(frozen=True)
class Ego:
    """A scene to cut: the moment and the agent at its middle; the event it was picked for, and who that is about."""

    moment: int
    agent: int
    event: str | None = None
    about: int = -1


@dataclasses.dataclass(frozen=True)
class World:
    """Everything that was made, in right-hand traffic; scenes of ``mirrored`` worlds drive on the left."""

    name: str
    domain: str
    kind: str
    mirrored: bool
    net: Network
    tracks: Tracks
    ground: Ground
    moments: tuple[Actors, ...]
    lights: tuple[np.ndarray, ...]
    egos: tuple[Ego, ...]


def make_world(seed: int, k: int, kinds: Sequence[str] = ()) -> World:
    """World ``k`` of ``seed``.

    Args:
      kinds: events of which one is staged, if the world has a place for it; none: any or none, as domains have it.

    Raises:
      ValueError: if one of the numbers is negative.
    """
    if seed < 0 or k < 0:
        raise ValueError(f"seed is {seed} and k is {k}: worlds are counted from 0")
    rng = np.random.default_rng([VERSION, seed, k])
    domain = domains.draw(rng)
    kind, net = domain.network(rng)
    tracks = track(net)
    timings = [Timing.drawn(junction, rng) for junction in net.junctions if junction.phases]
    shown = bool(timings) and rng.random() < 0.8  # at times the lights are not recorded
    staged = None
    if rng.random() < (1.0 if kinds else domains.EVENTS):
        chosen = kinds or EVENTS
        staged = events.stage(chosen[int(rng.integers(len(chosen)))], net, tracks, rng)
    fleet = fill(tracks, domain.density(net, tracks, rng), lambda n: actors.vehicle_sizes(n, rng), rng)
    if staged is not None:
        fleet = events.obstruct(staged, net, tracks, fleet, rng)
    simulation = Simulation(tracks, timings, fleet, rng)
    crowd, riders = domain.people(rng)
    others = bystanders.draw(net, tracks, crowd, riders, rng)
    simulation.run(_WARM_UP)
    moments, lights, found = [], [], []
    for moment in range(MOMENTS):
        if moment:
            simulation.run(APART)
        scene = _clear(
            actors.together(
                [
                    _driving(fleet, net, tracks),
                    bystanders.at_time(others, tracks, simulation.lights, simulation.time, rng),
                ]
            )
        )
        about, event = -1, None
        if staged is not None and (happened := events.happen(staged, net, tracks, scene, rng)) is not None:
            scene, about, event = happened
        moments.append(scene)
        lights.append(simulation.lights.copy() if shown else np.zeros_like(simulation.lights))
        found += _egos(scene, net, moment, about, event, rng)
    return World(
        f"{domain.name}-{seed}-{k:06d}", domain.name, kind, domain.left_hand, net, tracks, Ground.drawn(rng),
        tuple(moments), tuple(lights), tuple(_spread(found, moments)),
    )  # fmt: skip


def _driving(fleet: Fleet, net: Network, tracks: Tracks) -> Actors:
    """The fleet as boxes on the map."""
    on = np.flatnonzero(fleet.lane >= 0)
    lane, at = fleet.lane[on], fleet.at[on]
    places, headings = tracks.place(lane, at)
    places = places + fleet.aside[on, None] * np.stack([-np.sin(headings), np.cos(headings)], -1)
    height = np.array([lane.height for lane in net.lanes])
    return actors.make(AgentType.VEHICLE, places, headings, fleet.speed[on], fleet.sizes[on], height[lane], lane)


def _clear(scene: Actors) -> Actors:
    """Without those who would stand in others; who drives stays, and of two that drive the earlier one."""
    pairs = actors.overlapping(scene)
    if not len(pairs):
        return scene
    return scene.select(np.setdiff1d(np.arange(len(scene)), pairs[:, 1]))


def _egos(scene: Actors, net: Network, moment: int, about: int, event: str | None, rng) -> list[Ego]:
    """Vehicles on lanes near the middle, by chance; first of all those that see the event."""
    drives = (scene.types == AgentType.VEHICLE) & (scene.lane >= 0) & (np.hypot(*scene.places.T) < _VIEW)
    rows = np.flatnonzero(drives & (scene.level == 0))
    # Most near a junction: that is where recordings dwell.
    centres = np.array([junction.centre for junction in net.junctions]).reshape(-1, 1, 2)
    near = (np.linalg.norm(scene.places[rows] - centres, axis=-1) < _BUSY).any(0)
    rows = rows[near | (rng.random(len(rows)) < (_ELSEWHERE if near.any() else 1.0))]
    found = []
    if event is not None:
        ahead = np.stack([np.cos(scene.headings), np.sin(scene.headings)], -1)
        to = scene.places[about] - scene.places[rows]
        along, left = (to * ahead[rows]).sum(-1), ahead[rows, 0] * to[:, 1] - ahead[rows, 1] * to[:, 0]
        sees = rows[(np.abs(along) < 21) & (np.abs(left) < 20) & (rows != about)]
        sees = [int(row) for row in sees if events.shows(event, net, scene, about, int(row))]
        found += [Ego(moment, row, event, about) for row in sees[:4]]
        # Other scenes must not show the event at their edge, unlabelled.
        far = np.hypot(*(scene.places - scene.places[about]).T) > 50.0
        rows = rows[far[rows]]
    return found + [Ego(moment, int(row)) for row in rows]


def _spread(found: list[Ego], moments: list[Actors]) -> list[Ego]:
    """At most ``CROPS`` egos, ``_SPACING`` metres apart over all moments; those with events first, and closer."""
    seen = [0] * len(moments)
    rank = []
    for ego in found:
        rank.append(seen[ego.moment])
        seen[ego.moment] += 1
    # In turn from every moment, in the order in which each was drawn.
    order = sorted(range(len(found)), key=lambda i: (found[i].event is None, rank[i]))
    kept, places = [], np.zeros((0, 2))
    for i in order:
        ego = found[i]
        place = moments[ego.moment].places[ego.agent]
        apart = _SPACING if ego.event is None else _SPACING / 3
        if len(kept) < CROPS and (np.hypot(*(places - place).T) >= apart).all():
            kept.append(ego)
            places = np.concatenate([places, place[None]])
    return kept


def raw_scene(world: World) -> Log:
    """The world as a recording whose steps are its moments; objects of different moments are different objects."""
    flip = -1.0 if world.mirrored else 1.0
    counts = [len(moment) for moment in world.moments]
    everyone = actors.together(list(world.moments))
    step = np.repeat(np.arange(len(counts)), counts)
    total, steps = len(everyone), len(counts)
    valid = np.zeros((total, steps), bool)
    valid[np.arange(total), step] = True
    places = everyone.places * np.array([1.0, flip])
    ground = world.ground.height(everyone.places) + everyone.level
    position = np.column_stack([places, ground + everyone.sizes[:, 2] / 2])
    heading = flip * everyone.headings
    velocity = everyone.speeds[:, None] * np.stack([np.cos(heading), np.sin(heading)], -1)
    lit = np.flatnonzero((np.stack(world.lights) != Signal.UNKNOWN).any(0))
    return Log(
        timestamps=_WARM_UP + APART * np.arange(steps),
        object_ids=tuple(map(str, range(total))),
        object_types=everyone.types.astype(int),
        valid=valid,
        positions=np.where(valid[..., None], position[:, None], 0.0),
        headings=np.where(valid, heading[:, None], 0.0),
        velocities=np.where(valid[..., None], velocity[:, None], 0.0),
        sizes=everyone.sizes,
        signal_lane_ids=tuple(str(lane) for lane in lit),
        signal_states=np.stack(world.lights, 1)[lit].astype(np.int8),
        signal_positions=np.full((len(lit), 3), np.nan),
        lanes=_raw_lanes(world, flip),
        has_topology=True,
        metadata=LogMetadata(
            domain=world.domain,
            scene_id=world.name,
            location_cluster=world.name,
            variant="synthetic",
            source_file=f"synthetic world {world.name}",
            source_sha256=hashlib.sha256(f"{VERSION} {world.name}".encode()).hexdigest(),
        ),
    )


def object_of(world: World, moment: int, agent: int) -> int:
    """Index in ``raw_scene`` of an agent of a moment."""
    return sum(len(world.moments[m]) for m in range(moment)) + agent


def _raw_lanes(world: World, flip: float) -> tuple[MapLane, ...]:
    lanes = world.net.lanes
    before: list[list[str]] = [[] for _ in lanes]
    for k, lane in enumerate(lanes):
        for after in lane.successors:
            before[after].append(str(k))
    found = []
    for k, lane in enumerate(lanes):
        z = world.ground.height(lane.points) + lane.height
        points = np.column_stack([lane.points * np.array([1.0, flip]), z])
        sides = [() if other is None else (LaneNeighbor(str(other)),) for other in (lane.left, lane.right)]
        left, right = sides if flip > 0 else sides[::-1]
        after = tuple(str(j) for j in lane.successors)
        found.append(MapLane(str(k), lane.subtype, points, tuple(before[k]), after, left, right))
    return tuple(found)
