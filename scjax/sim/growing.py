"""A closed loop on a map that grows ahead of the driven agent."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from scjax.data.map_joins import connect_lanes
from scjax.generate.conditions import Condition
from scjax.scene import AgentType, Map, Scene, map_to_log, scene_to_map
from scjax.sim.agents import LanePlaces
from scjax.sim.arrivals import arrivals_too_near
from scjax.sim.behavior import BehaviorModel
from scjax.sim.closed_loop import DrivingTerms
from scjax.sim.drive_loop import DriveResult, actor_row, drive_segment, start_state, terms_on_host
from scjax.sim.jams import JamWatch
from scjax.sim.map_growth import MapGrowth, in_front_half
from scjax.sim.policies import Policy
from scjax.sim.preparation import Start, pad_start, prepare
from scjax.sim.road_network import NONE
from scjax.sim.route_follower import ON_ROAD, RouteFollower
from scjax.sim.simulate import TIME_STEP, key_seed, padded_signals
from scjax.sim.track_log import TrackLog
from scjax.sim.walking import STANDS

SEGMENT = 20  # steps between two looks at what is left of the way
LOOK_AHEAD = 140.0  # m of the way that must be there: a tile that leads nowhere is known before it comes in sight
AROUND = 160.0  # m from the driven agent, within which traffic moves
_SHAPE = (128, 16384, 1024, 2048)  # as ``Start.shape``, of nearly all moments, so that the loop compiles once
_SIGNALS = 256  # likewise
_ROUTE_LANES = 32
_TILES_AT_ONCE = 8  # of 32 m; more are added two seconds later
_ROOM = 1.35  # m to the side of a centerline, of a car that passes; lanes that swerve leave 1.4 m
_BESIDE_PEOPLE = 0.25  # m more, beside pedestrians: lanes do not swerve around them
_WIDTH = 2.2  # m, of the widest car; what is wider needs more room
_PASSING = 30.0  # m between two bodies that a car may have to pass on different sides


class GrowingDrive:
    """The loop with its present map.

    Args:
      key: typed key.
      source: a scene or a map.
      condition: what new tiles show.
      outpainting: ``route`` as in ``scjax.outpaint``, and options of ``scjax.extend_map``.
      others: as in ``scjax.drive``.
    """

    def __init__(
        self,
        key: Array,
        source: Scene | Map,
        policy: Policy,
        *,
        condition: Condition | str | None,
        policy_state: Any,
        behavior: BehaviorModel,
        actor: str | None,
        **outpainting: Any,
    ):
        world = scene_to_map(source) if isinstance(source, Scene) else source
        tile_key, self.key = jax.random.split(key)
        self.world_grows = True
        if isinstance(behavior, RouteFollower):  # nobody enters at the border: new tiles bring traffic of their own
            behavior = dataclasses.replace(behavior, entry_delay=None)
        self.policy, self.policy_state, self.behavior = policy, policy_state, behavior
        self.clock, self.number, self.has_ended = 0.0, 0, False
        first = connect_lanes(world)
        self.start = prepare(with_first_stop_lines(first), 0, self._rng())
        self.row = actor_row(self.start, actor)
        self.actor = self.start.log.object_ids[self.row]
        way, yaw = outpainting.pop("route", "straight"), float(self.start.agents.heading[self.row])
        self.growth = MapGrowth(tile_key, first, condition, way=way, yaw=yaw, rng=self._rng(), **outpainting)
        self.track = TrackLog(self.start)
        self.terms: list[dict[str, np.ndarray]] = []
        self.seen = set(self.world.agent_ids)
        self.jams = JamWatch()
        self._begin(self.start)

    @property
    def world(self) -> Map:
        """The map as it is now."""
        return self.growth.map

    @property
    def progress(self) -> float:
        """Distance driven so far [m]."""
        return sum(float(one["progress"].sum()) for one in self.terms)

    def segments(self, steps: int) -> Iterator[None]:
        """Drives on for ``steps`` steps, or until the agent has left the map; pauses every two seconds."""
        while self.track.num_steps <= steps and not self.has_ended:
            self._advance(min(SEGMENT, steps + 1 - self.track.num_steps))
            yield

    def result(self) -> DriveResult:
        """What has happened so far."""
        log = self.track.log(map_to_log(self.world), self.actor, TIME_STEP)
        terms = {name: np.concatenate([one[name] for one in self.terms]) for name in DrivingTerms._fields}
        return DriveResult(log, self.actor, terms, self.world)

    def _advance(self, steps: int) -> None:
        """Drives on by ``steps`` steps; the map has grown before where it must."""
        self._grow()
        start = self.start
        signals = padded_signals([start], steps, self.clock)[0]
        signals = np.pad(signals, ((0, 0), (0, max(_SIGNALS - signals.shape[1], 0))))
        self.state, self.policy_state, after, terms = drive_segment(
            jax.random.fold_in(self.key, self.number),
            start.network,
            self.state,
            signals,
            jnp.int32(self.row),
            self.policy_state,
            policy=self.policy,
            behavior=self.behavior,
            dt=TIME_STEP,
        )
        self.clock += steps * TIME_STEP
        shown = start.plan.states(self.clock + (1 + np.arange(steps) - steps) * TIME_STEP)
        self.track.add(start, {name: np.asarray(values) for name, values in after.items()}, shown)
        self.terms.append(terms_on_host(terms))
        self.has_ended = not bool(self.state.agents.valid[self.row])
        if (row := self.jams.blocking_row(start, self.state.agents, self.clock, self.row)) is not None:
            agents = self.state.agents
            self.state = self.state.replace(agents=agents.replace(valid=agents.valid.at[row].set(False)))

    def _grow(self) -> None:
        """Adds tiles at the end of the ego's way until enough of it is there, or no tile goes on; a few at once."""
        for _ in range(_TILES_AT_ONCE):
            if self._way_left() >= LOOK_AHEAD or not self.world_grows:
                return
            first = self._lane_ids()[-1]
            place = np.array([self.state.agents.x[self.row], self.state.agents.y[self.row]]) + self.start.origin[:2]
            self.world_grows = self.growth.extend(first, place)
            if not self.world_grows:
                return
            traffic = self._with_traffic(self.world)
            start = self._prepare(traffic)
            new = set(traffic.agent_ids) - self.seen
            blocking = arrivals_in_the_way(start, new, self._in_the_way(start), self.in_the_way)
            if excluded := blocking | arrivals_too_near(start, new, blocking):
                start = self._prepare(_without_agents(traffic, excluded))
            self._begin(start)
            self.seen |= set(self.world.agent_ids)

    def _in_the_way(self, start: Start) -> set[str]:
        return bodies_in_the_way(start, float(start.agents.width[start.log.object_ids.index(self.actor)]))

    def _begin(self, start: Start) -> None:
        """Starts from a moment on a new network."""
        self.in_the_way = self._in_the_way(start)
        start = pad_start(start, tuple(max(sizes) for sizes in zip(start.shape, _SHAPE, strict=True)))
        row, number = start.log.object_ids.index(self.actor), self.number + 1
        if number > 1:
            start = dataclasses.replace(start, places=_on_lanes(start, row, self._lane_ids()))
        self.start, self.number, self.row = start, number, row
        self.state = start_state(
            jax.random.fold_in(self.key, self.number),
            start.network,
            start.agents,
            start.places,
            jnp.int32(self.row),
            lanes=_route_rows(
                int(np.asarray(start.places.lane)[self.row]),
                np.asarray(start.network.successors),
                start.lane_ids,
                self.growth.path,
            ),
            behavior=self.behavior,
        )

    def _lane_ids(self) -> tuple[str, ...]:
        """Lanes of the map that the driven agent is on."""
        return self.start.lane_ids[int(np.asarray(self.state.route.lanes)[0, 0])]

    def _rng(self) -> np.random.Generator:
        return np.random.default_rng(key_seed(self.key))

    def _way_left(self) -> float:
        """What is left of the ego's way [m]."""
        lanes = np.asarray(self.state.route.lanes[0])
        lengths = np.asarray(self.start.network.length)[lanes[lanes >= 0]]
        return float(lengths.sum() - self.state.route.along[0])

    def _prepare(self, world: Map) -> Start:
        """The start on the lanes near the ego; signals that were there keep their phases."""
        start, old = prepare(world, 0, self._rng()), self.start
        rows = {lane_id: row for row, lane_id in enumerate(old.log.signal_lane_ids)}
        plan = {name: getattr(start.plan, name).copy() for name in ("cycle", "green", "offset")}
        plan["offset"] -= self.clock  # a plan counts from the start of the loop
        for row, lane_id in enumerate(start.log.signal_lane_ids):
            if lane_id in rows:
                for name, values in plan.items():
                    values[row] = getattr(old.plan, name)[rows[lane_id]]
        return dataclasses.replace(start, plan=type(start.plan)(**plan))

    def _with_traffic(self, world: Map) -> Map:
        """``world`` with the agents as they are now, and those of tiles that have not been seen; lanes near the ego."""
        world = with_first_stop_lines(world)
        ids, states, types = self.track.present(self.start, self.state.agents)
        fresh = [row for row, name in enumerate(world.agent_ids) if name not in self.seen]
        states = np.concatenate([states, world.agents[fresh]])
        ids = (*ids, *(world.agent_ids[row] for row in fresh))
        types = np.concatenate([types, world.agent_types[fresh]])
        ego = states[ids.index(self.actor), :2]
        near = np.hypot(*(states[:, :2] - ego).T) < AROUND
        for tile in self.growth.gone:  # who was on it is gone with it, out of sight of the ego
            near &= ~in_front_half(states[:, :2], tile) | np.isin(ids, [world.agent_ids[row] for row in fresh])
        lanes = tuple(lane for lane in world.lanes if np.hypot(*(lane.points[:, :2] - ego).T).min() < AROUND)
        names = {lane.id for lane in lanes}
        lit = [row for row, lane_id in enumerate(world.signal_lane_ids) if lane_id in names]
        now = dict(
            zip(self.start.log.signal_lane_ids, self.start.plan.states(np.array([self.clock]))[:, 0], strict=True)
        )
        shown = [now.get(world.signal_lane_ids[row], world.signal_states[row]) for row in lit]
        return dataclasses.replace(
            world,
            lanes=lanes,
            signal_lane_ids=tuple(world.signal_lane_ids[row] for row in lit),
            signal_states=np.array(shown, np.int32),
            signal_positions=world.signal_positions[lit],
            agent_ids=tuple(name for name, keep in zip(ids, near, strict=True) if keep),
            agents=states[near],
            agent_types=types[near],
        )


def with_first_stop_lines(map: Map) -> Map:
    """``map`` without signals of lanes that only lanes with a signal lead into.

    Lanes that go on across a seam take over the state of the signal before them, but not its phases: a second stop line
    inside of the junction, at which traffic would stop in the way of others.
    """
    lit, before = set(map.signal_lane_ids), collections.defaultdict[str, set[str]](set)
    for lane in map.lanes:
        for following in lane.successors:
            before[following].add(lane.id)
    rows = [k for k, name in enumerate(map.signal_lane_ids) if not before[name] or not before[name] <= lit]
    return dataclasses.replace(
        map,
        signal_lane_ids=tuple(map.signal_lane_ids[row] for row in rows),
        signal_states=map.signal_states[rows],
        signal_positions=map.signal_positions[rows],
    )


def bodies_in_the_way(start: Start, width: float = _WIDTH) -> set[str]:
    """Ids of bodies that stay where they are and leave too little room for a vehicle so wide [m]: queues would not end.

    They are vehicles and obstacles that follow no lane, and pedestrians who stand beside the road.
    """
    from scipy.spatial import KDTree

    log, count, network = start.log, start.log.num_objects, start.network
    points = np.unique(np.stack([network.x, network.y], -1), axis=0)  # lanes that swerve where there is room
    follows_none = start.places.lane[:count] == NONE
    tree, names = KDTree(points), set[str]()
    for row in np.flatnonzero(follows_none):
        center, heading = np.array([start.agents.x[row], start.agents.y[row]]), float(start.agents.heading[row])
        room = _ROOM + max(width - _WIDTH, 0.0) / 2
        if log.object_types[row] == AgentType.PEDESTRIAN:
            if start.agents.speed[row] > STANDS or tree.query(center)[0] < ON_ROAD:
                continue  # walks on
            room += _BESIDE_PEOPLE
        half = log.sizes[row, :2] / 2
        offset = points[tree.query_ball_point(center, float(np.hypot(*half)) + room)] - center
        cos, sin = np.cos(heading), np.sin(heading)
        outside = np.maximum(np.abs(offset @ np.array([[cos, -sin], [sin, cos]])) - half, 0.0)
        if (np.hypot(*outside.T) < room).any():
            names.add(log.object_ids[row])
    return names


def arrivals_in_the_way(start: Start, new: set[str], in_the_way: set[str], before: set[str]) -> set[str]:
    """Those of the new bodies that are in the way, or with which one that was there before is in the way now.

    Lanes swerve around a body, but not between two on both sides.

    Args:
      new: ids of agents of ``start``.
      in_the_way: ids of bodies that are in the way, among all agents.
      before: ids of those that were without the new agents.
    """
    ids, places = start.log.object_ids, np.array(start.log.positions[:, 0, :2])
    closed = [row for row, name in enumerate(ids) if name in in_the_way - new - before]
    apart = np.hypot(*np.moveaxis(places[:, None] - places[closed][None], -1, 0)).min(1, initial=np.inf)
    stands = np.asarray(start.places.lane)[: len(ids)] == NONE
    beside = {ids[row] for row in np.flatnonzero(stands & (apart < _PASSING))}
    return (in_the_way | beside) & new


def _without_agents(map: Map, names: set[str]) -> Map:
    keep = np.array([name not in names for name in map.agent_ids], bool)
    return dataclasses.replace(
        map,
        agent_ids=tuple(name for name in map.agent_ids if name not in names),
        agents=map.agents[keep],
        agent_types=map.agent_types[keep],
    )


def _on_lanes(start: Start, row: int, names: tuple[str, ...]) -> LanePlaces:
    """The places with the agent on the nearest of the lanes of these names, whatever lane is nearer to it."""
    lanes, places = start.lanes, start.places
    rows = [lane for lane, ids in enumerate(start.lane_ids) if not set(ids).isdisjoint(names)]
    points = np.flatnonzero(np.isin(lanes.lane, rows))
    if not len(points):
        return places
    offset = np.array([start.agents.x[row], start.agents.y[row]]) - lanes.points[points, :2]
    point = points[np.hypot(*offset.T).argmin()]
    fields = {"lane": lanes.lane[point], "along": lanes.along[point], "is_parked": False}
    changed = {name: np.array(getattr(places, name)) for name in fields}
    for name, value in fields.items():
        changed[name][row] = value
    return places.replace(**changed)


def _route_rows(
    first: int, successors: Int[np.ndarray, "lanes _"], lane_ids: Sequence[tuple[str, ...]], path: Sequence[str]
) -> Int[np.ndarray, " R"]:
    """Lanes of the network from the agent's, ``first``, along successors to the one that holds the end of ``path``.

    The network ends at some distance from the agent: where it does not hold the end, the farthest lane of ``path`` that
    can be reached. Without one, the agent's lane alone.
    """
    out = np.full(_ROUTE_LANES, NONE, np.int32)
    if first == NONE:
        return out
    came_from, queue = {first: NONE}, collections.deque([first])
    while queue:
        lane = queue.popleft()
        for following in successors[lane].tolist():
            if following >= 0 and following not in came_from:
                came_from[following] = lane
                queue.append(following)
    holders = {name: lane for lane in reversed(came_from) for name in lane_ids[lane]}
    way = [next((holders[name] for name in reversed(path) if name in holders), first)]
    while came_from[way[-1]] != NONE:
        way.append(came_from[way[-1]])
    way = way[::-1][:_ROUTE_LANES]
    out[: len(way)] = way
    return out
