"""A synthetic world: a map, its traffic at some moments, and the vehicles whose surroundings become scenes.

World k of a seed depends on these two numbers only. ``scjax.synthetic.recording`` turns it into a ``Log``, so that
its scenes take the same way as recorded ones.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from scjax.language.events import EVENTS
from scjax.scene import AgentType
from scjax.synthetic import actors, domains
from scjax.synthetic.actors import Actors
from scjax.synthetic.bystanders import Bystanders, bystanders_at, draw_bystanders
from scjax.synthetic.events import EventOutcome, StagedEvent, draw_event
from scjax.synthetic.ground import Ground
from scjax.synthetic.lane_arrays import LaneArrays, build_lane_arrays
from scjax.synthetic.network import Network
from scjax.synthetic.network_types import draw_network
from scjax.synthetic.signals import SignalTiming
from scjax.synthetic.traffic import TrafficSimulation, draw_fleet

VERSION = 3  # raise it with every change of what a seed gives
MAX_SCENES = 15  # per world
_NUM_MOMENTS = 3
_MOMENT_INTERVAL = 9.0  # s
_WARM_UP_TIME = 22.0  # s of traffic before the first moment
_SIGNALS_RECORDED_SHARE = 0.8  # of the worlds with signals
_EGO_DISTANCE = 14.0  # m between the egos of a world, over all moments
_EVENT_EGO_DISTANCE = _EGO_DISTANCE / 3  # m for egos that see an event
_JUNCTION_DISTANCE = 30.0  # m, recordings dwell close to junctions
_ELSEWHERE_SHARE = 0.2  # of the vehicles further from junctions that become egos
_MAX_EGO_RADIUS = 78.0  # m from the center of the map
_EVENT_ALONG, _EVENT_LATERAL = 21, 20  # m from an ego to an event that its scene shows
_MAX_EVENT_EGOS = 4  # per moment
_EVENT_CLEARANCE = 50.0  # m from an event to egos without it


@dataclasses.dataclass(frozen=True)
class Ego:
    """A scene of a world.

    Attributes:
      moment, agent: indices of the moment and of the ego in it.
      event: the rare event that the scene shows.
      event_agent: index of the agent that the event is about; -1 without an event.
    """

    moment: int
    agent: int
    event: str | None = None
    event_agent: int = -1


@dataclasses.dataclass(frozen=True)
class World:
    """A world in right-hand traffic.

    Attributes:
      name: "<domain>-<seed>-<number>".
      domain, network_type: of the map.
      mirrored: whether its scenes are mirrored for left-hand traffic.
      net, lanes: the road network, and its lanes as arrays.
      ground: the terrain.
      moments: all agents at each moment.
      signals: ``Signal`` of every lane at each moment [lanes].
      egos: the scenes.
    """

    name: str
    domain: str
    network_type: str
    mirrored: bool
    net: Network
    lanes: LaneArrays
    ground: Ground
    moments: tuple[Actors, ...]
    signals: tuple[np.ndarray, ...]
    egos: tuple[Ego, ...]


def make_world(seed: int, k: int, events: Sequence[str] = (), event_share: float = domains.EVENT_SHARE) -> World:
    """World ``k`` of ``seed``.

    Args:
      events: names of events; the world shows one of them if it has a place for it. Empty: any event or none.
      event_share: probability of an event if ``events`` is empty.

    Raises:
      ValueError: if one of the numbers is negative.
    """
    if seed < 0 or k < 0:
        raise ValueError(f"seed is {seed} and k is {k}: worlds are counted from 0")
    rng = np.random.default_rng([VERSION, seed, k])
    domain = domains.draw_domain(rng)
    network_type = domain.draw_network_type(rng)
    net = draw_network(network_type, domain.style, rng)
    lanes = build_lane_arrays(net)
    timings = [SignalTiming.draw(junction, rng) for junction in net.junctions if junction.phases]
    records_signals = bool(timings) and rng.random() < _SIGNALS_RECORDED_SHARE
    staged_event = None
    if rng.random() < (1.0 if events else event_share):
        choices = events or EVENTS
        staged_event = draw_event(choices[int(rng.integers(len(choices)))], net, lanes, rng)
    densities = domain.draw_densities(net, lanes, rng)
    fleet = draw_fleet(lanes, densities, lambda count: actors.draw_vehicle_sizes(count, rng), rng)
    if staged_event is not None:
        fleet = staged_event.prepare_traffic(fleet, rng)
    simulation = TrafficSimulation(lanes, timings, fleet, rng)
    pedestrian_density, cyclist_density = domain.pedestrians.draw(rng), domain.cyclists.draw(rng)
    bystanders = draw_bystanders(net, lanes, pedestrian_density, cyclist_density, rng)
    moments, signals, egos = [], [], []
    for moment in range(_NUM_MOMENTS):
        simulation.run(_MOMENT_INTERVAL if moment else _WARM_UP_TIME)
        scene = _agents_at(simulation, bystanders, net, rng)
        outcome = None if staged_event is None else staged_event.apply(scene, rng)
        moments.append(scene if outcome is None else outcome.scene)
        signals.append(simulation.signals.copy() if records_signals else np.zeros_like(simulation.signals))
        egos += _draw_egos(moments[-1], net, moment, staged_event, outcome, rng)
    return World(
        name=f"{domain.name}-{seed}-{k:06d}",
        domain=domain.name,
        network_type=network_type,
        mirrored=domain.left_hand,
        net=net,
        lanes=lanes,
        ground=Ground.draw(rng),
        moments=tuple(moments),
        signals=tuple(signals),
        egos=tuple(_select_egos(egos, moments)),
    )


def moment_times(count: int) -> Float64[np.ndarray, " count"]:
    """Times of the first ``count`` moments of a world [s]."""
    return _WARM_UP_TIME + _MOMENT_INTERVAL * np.arange(count)


def _agents_at(simulation: TrafficSimulation, bystanders: Bystanders, net: Network, rng: np.random.Generator) -> Actors:
    """Traffic and bystanders now. Of two agents that overlap the first stays; vehicles in traffic come first."""
    standing = bystanders_at(bystanders, simulation.lanes, simulation.signals, simulation.time, rng)
    agents = actors.concatenate_actors([_traffic_agents(simulation, net), standing])
    pairs = actors.overlapping_actors(agents)
    if not len(pairs):
        return agents
    return agents.select(np.setdiff1d(np.arange(len(agents)), pairs[:, 1]))


def _traffic_agents(simulation: TrafficSimulation, net: Network) -> Actors:
    """The vehicles of a simulation that are on the map."""
    fleet = simulation.fleet
    rows = np.flatnonzero(fleet.lane >= 0)
    lane = fleet.lane[rows]
    positions, headings = simulation.lanes.poses_at(lane, fleet.along[rows])
    positions = positions + fleet.lateral[rows, None] * np.stack([-np.sin(headings), np.cos(headings)], -1)
    level = np.array([lane.height for lane in net.lanes])[lane]
    return actors.make_actors(AgentType.VEHICLE, positions, headings, fleet.speed[rows], fleet.sizes[rows], level, lane)


def _draw_egos(
    scene: Actors,
    net: Network,
    moment: int,
    staged_event: StagedEvent | None,
    outcome: EventOutcome | None,
    rng: np.random.Generator,
) -> list[Ego]:
    """Random vehicles on lanes close to the center of the map, most of them near junctions; first those with the event.

    Egos without the event are far from it, so that no scene shows an event without a label.
    """
    in_traffic = (scene.types == AgentType.VEHICLE) & (scene.lane >= 0) & (scene.level == 0)
    rows = np.flatnonzero(in_traffic & (np.hypot(*scene.positions.T) < _MAX_EGO_RADIUS))
    centers = np.array([junction.center for junction in net.junctions]).reshape(-1, 1, 2)
    near_junction = (np.linalg.norm(scene.positions[rows] - centers, axis=-1) < _JUNCTION_DISTANCE).any(0)
    share_elsewhere = _ELSEWHERE_SHARE if near_junction.any() else 1.0
    rows = rows[near_junction | (rng.random(len(rows)) < share_elsewhere)]
    if staged_event is None or outcome is None:
        return [Ego(moment, int(row)) for row in rows]
    agent = outcome.agent
    direction = np.stack([np.cos(scene.headings), np.sin(scene.headings)], -1)[rows]
    offset = scene.positions[agent] - scene.positions[rows]
    along = (offset * direction).sum(-1)
    left = direction[:, 0] * offset[:, 1] - direction[:, 1] * offset[:, 0]
    in_view = (np.abs(along) < _EVENT_ALONG) & (np.abs(left) < _EVENT_LATERAL) & (rows != agent)
    witnesses = [int(row) for row in rows[in_view] if staged_event.is_visible(scene, agent, int(row))]
    egos = [Ego(moment, row, outcome.event, agent) for row in witnesses[:_MAX_EVENT_EGOS]]
    is_far = np.hypot(*(scene.positions - scene.positions[agent]).T) > _EVENT_CLEARANCE
    return egos + [Ego(moment, int(row)) for row in rows[is_far[rows]]]


def _select_egos(egos: list[Ego], moments: list[Actors]) -> list[Ego]:
    """At most ``MAX_SCENES`` egos at some distance from each other, those with events first."""
    counts = [0] * len(moments)
    number_in_moment = []
    for ego in egos:
        number_in_moment.append(counts[ego.moment])
        counts[ego.moment] += 1
    # One of each moment in turn.
    order = sorted(range(len(egos)), key=lambda i: (egos[i].event is None, number_in_moment[i]))
    selected, positions = [], np.zeros((0, 2))
    for ego in (egos[i] for i in order):
        position = moments[ego.moment].positions[ego.agent]
        min_distance = _EGO_DISTANCE if ego.event is None else _EVENT_EGO_DISTANCE
        if len(selected) < MAX_SCENES and (np.hypot(*(positions - position).T) >= min_distance).all():
            selected.append(ego)
            positions = np.concatenate([positions, position[None]])
    return selected
