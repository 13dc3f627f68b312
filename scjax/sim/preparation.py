"""A log, map or scene at one moment -> what a roll-out starts from, padded; NumPy on the host."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from scjax.data.agents import clean_agents
from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, Log, Map, Scene, map_to_log, scene_to_map
from scjax.scene.map import MapTile
from scjax.scene.scene import AnyArray
from scjax.scene.stop_points import stop_points
from scjax.sim.agents import MAX_SIMULATED, Agents, LanePlaces
from scjax.sim.clearance import swerve
from scjax.sim.network_of_map import LanePoints, build_road_network, lane_graph_of, space_points
from scjax.sim.places import place_agents
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.signal_plan import SignalPlan, plan_signals

_AGENT_STEP = 32  # agents are padded to multiples
_SMALLEST, _GROWTH = (4096, 256, 512), 4  # points, lanes and conflicts of small maps; larger ones are padded in steps


@dataclasses.dataclass(frozen=True)
class Start:
    """All that a roll-out of one scene needs.

    Attributes:
      log: the moment as a log of one step, of the objects that take part.
      origin: of the network's frame in that of the log [m].
      network, agents, places: padded, as NumPy arrays.
      plan: phases of the signals of ``log``.
      lanes: unpadded points of the lanes, in the network's frame.
      lane_ids: ids of the lanes of ``log`` that each lane of the network consists of.
    """

    log: Log
    origin: Float64[np.ndarray, 3]
    network: RoadNetwork
    agents: Agents
    places: LanePlaces
    plan: SignalPlan
    lanes: LanePoints
    lane_ids: tuple[tuple[str, ...], ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Padded sizes; scenes of one shape run in one batch."""
        network = self.network
        sizes = (self.agents.x, network.x, network.first, network.conflict_start)
        return tuple(len(values) for values in sizes)


def prepare(source: Log | Map | Scene, step: int, rng: np.random.Generator) -> Start:
    """The start of a roll-out of ``source``.

    Args:
      step: of a log.
      rng: for the phases of signals.

    Raises:
      ValueError: the map has no lane that cars may use, or there are more than 1,024 agents.
    """
    log, tiles = _one_step(source, step)
    graph = lane_graph_of(log)
    origin = np.concatenate([graph.points[:, :2].mean(0), [_ground(graph.points[:, 2])]])
    lanes = space_points(graph, origin)
    states = _states_of(log, origin)
    plan = _plan(log, rng)
    rows = {lane_id: row for row, lane_id in enumerate(log.signal_lane_ids)}
    network = build_road_network(log, graph, lanes, rows, tiles)
    places = place_agents(lanes, states, log.object_types, None if log.ego_index == NO_EGO else log.ego_index)
    shift = swerve(lanes, states[places.is_parked])
    network = network.replace(
        x=network.x + shift[:, 0].astype(np.float32), y=network.y + shift[:, 1].astype(np.float32)
    )
    agents = _agents_of(states, log.object_types)
    return Start(log, origin, *_padded(network, agents, places), plan, lanes, graph.lane_ids)


def _one_step(source: Log | Map | Scene, step: int) -> tuple[Log, Sequence[MapTile]]:
    """The moment as a log of one step whose objects all take part, and the tiles of a map."""
    tiles: Sequence[MapTile] = ()
    ego = NO_EGO
    if isinstance(source, Scene):
        source, ego = scene_to_map(source), 0
    if isinstance(source, Map):
        tiles = source.tiles
        log = map_to_log(source)
    else:
        if not 0 <= step < source.num_steps:
            raise ValueError(f"step is {step}: give one of the {source.num_steps} steps of the log, counted from 0")
        log, ego = source.select_steps([step]), source.ego_index
    rows = np.flatnonzero(log.valid[:, 0] & (log.object_types != OTHER_OBJECT))
    if len(rows) > MAX_SIMULATED:
        raise ValueError(f"{len(rows)} agents are more than {MAX_SIMULATED}: cut a smaller map")
    if ego != NO_EGO and ego in rows:  # the ego is row 0
        rows = np.concatenate([[ego], rows[rows != ego]])
        ego = 0
    else:
        ego = NO_EGO
    log = dataclasses.replace(
        log,
        object_ids=tuple(log.object_ids[row] for row in rows),
        object_types=log.object_types[rows],
        valid=log.valid[rows],
        positions=log.positions[rows],
        headings=log.headings[rows],
        velocities=log.velocities[rows],
        sizes=log.sizes[rows],
        ego_index=ego,
    )
    return log, tiles


def _ground(z: np.ndarray) -> float:
    known = z[np.isfinite(z)]
    return float(known.mean()) if len(known) else 0.0


def _states_of(log: Log, origin: np.ndarray) -> np.ndarray:
    """Columns of ``Scene.agents`` in the network's frame; unknown values are filled."""
    heading = log.headings[:, 0]
    direction = np.stack([np.cos(heading), np.sin(heading)], -1)
    speed = np.maximum((log.velocities[:, 0] * direction).sum(-1), 0.0)
    states = np.concatenate([log.positions[:, 0] - origin, speed[:, None], direction, log.sizes], axis=1)
    return clean_agents(states, log.object_types)[0]


def _agents_of(states: np.ndarray, types: np.ndarray) -> Agents:
    single = states.astype(np.float32)
    x, y, z, speed, cos, sin, length, width, height = single.T
    return Agents(
        x=x,
        y=y,
        z=z,
        heading=np.arctan2(sin, cos),
        speed=np.where(types == AgentType.STATIC, 0, speed).astype(np.float32),
        valid=np.ones(len(x), bool),
        length=length,
        width=width,
        height=height,
        kind=types.astype(np.int32),
        entries=np.zeros(len(x), np.int32),
    )


def _plan(log: Log, rng: np.random.Generator) -> SignalPlan:
    """Phases of the signals; those whose lane the map lacks have none."""
    points, count = stop_points(log), len(log.signal_lane_ids)
    headings = np.arctan2(points.directions[:, 1], points.directions[:, 0])
    known = plan_signals(points.positions, headings, log.signal_states[points.signals, 0], rng)
    plan = SignalPlan(*(np.zeros(count) for _ in range(3)))
    for field in dataclasses.fields(plan):
        getattr(plan, field.name)[points.signals] = getattr(known, field.name)
    return plan


def pad_start(start: Start, shape: tuple[int, ...]) -> Start:
    """``start`` with more rows that stand for nothing.

    Args:
      shape: as ``Start.shape``, nowhere smaller than that of ``start``.
    """
    network, agents, places = _pad(start.network, start.agents, start.places, shape)
    return dataclasses.replace(start, network=network, agents=agents, places=places)


def _padded(network: RoadNetwork, agents: Agents, places: LanePlaces) -> tuple[RoadNetwork, Agents, LanePlaces]:
    """All three in one of few shapes."""
    counts = (len(network.x), len(network.first), len(network.conflict_start) + 1)
    scale = 1
    while any(count > scale * smallest for count, smallest in zip(counts, _SMALLEST, strict=True)):
        scale *= _GROWTH
    count = -(-max(len(agents.x), 1) // _AGENT_STEP) * _AGENT_STEP
    return _pad(network, agents, places, (count, *(scale * smallest for smallest in _SMALLEST)))


def _pad(
    network: RoadNetwork, agents: Agents, places: LanePlaces, shape: tuple[int, ...]
) -> tuple[RoadNetwork, Agents, LanePlaces]:
    """All three with rows that stand for nothing."""
    count, points, lanes, conflicts = shape
    by_point = {"x", "y", "z", "heading", "lane", "limit"}
    fields = {f.name: getattr(network, f.name) for f in dataclasses.fields(network)}
    indices = {"successors", "signal", "left", "right", "conflicts"}
    out: dict[str, Any] = {}
    for name, values in fields.items():
        size = points if name in by_point else conflicts if name.startswith("conflict_") else lanes
        if name in by_point and len(values):  # extents of the map stay
            out[name] = np.concatenate([values, np.full(size - len(values), values[-1], values.dtype)])
        else:
            out[name] = _fill(values, size, NONE if name in indices else 1 if name in ("spacing", "intervals") else 0)
    out["conflict_other"] = _fill(fields["conflict_other"], conflicts, conflicts - 1)
    wide = Agents(**{f.name: _fill(getattr(agents, f.name), count, 0) for f in dataclasses.fields(agents)})
    wide = wide.replace(length=np.maximum(wide.length, 0.1), width=np.maximum(wide.width, 0.1))
    rows = {f.name: _fill(getattr(places, f.name), count, 0) for f in dataclasses.fields(places)}
    rows["lane"] = _fill(places.lane, count, NONE)
    rows["is_parked"] = _fill(places.is_parked, count, 1)
    return RoadNetwork(**out), wide, LanePlaces(**rows)


def _fill(values: AnyArray, size: int, value: int) -> np.ndarray:
    rest = np.full((size - len(values), *values.shape[1:]), value, values.dtype)
    return np.concatenate([values, rest])
