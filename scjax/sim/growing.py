"""A closed loop on a map that grows ahead of the driven agent."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from scjax.data.map_joins import connect_lanes
from scjax.generate.conditions import Condition
from scjax.outpainting.exits import choose_exit, find_exits
from scjax.outpainting.extend import extend_map
from scjax.outpainting.route_search import MAX_TRIES
from scjax.scene import AgentType, Map, Scene, map_to_log, scene_to_map
from scjax.sim.behavior import BehaviorModel
from scjax.sim.closed_loop import DrivingTerms
from scjax.sim.drive_loop import DriveResult, actor_row, drive_segment, start_state, terms_on_host
from scjax.sim.policies import Policy
from scjax.sim.preparation import Start, prepare
from scjax.sim.road_network import NONE
from scjax.sim.route_follower import RouteFollower
from scjax.sim.simulate import TIME_STEP, key_seed, padded_signals
from scjax.sim.track_log import TrackLog

SEGMENT = 20  # steps between two looks at what is left of the way
LOOK_AHEAD = 90.0  # m of the way that must be there
AROUND = 200.0  # m from the driven agent, within which traffic moves
_ROUTE_LANES = 32
_IN_THE_WAY = 2.5  # m from a centerline


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
        self.tile_key, self.key = jax.random.split(key)
        self.world, self.condition = connect_lanes(world), condition
        self.way, self.outpainting = outpainting.pop("route", "straight"), outpainting
        self.world_grows, self.tries, self.goal = True, collections.Counter[str](), ""
        if isinstance(behavior, RouteFollower):  # nobody enters at the border: new tiles bring traffic of their own
            behavior = dataclasses.replace(behavior, entry_delay=None)
        self.policy, self.policy_state, self.behavior = policy, policy_state, behavior
        self.clock, self.number, self.has_ended = 0.0, 0, False
        self.start = prepare(self.world, 0, self._rng())
        self.row = actor_row(self.start, actor)
        self.actor = self.start.log.object_ids[self.row]
        self.yaw = float(self.start.agents.heading[self.row])
        self.track = TrackLog(self.start)
        self.terms: list[dict[str, np.ndarray]] = []
        self.seen = set(self.world.agent_ids)
        self._begin(self.start)

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

    def _grow(self) -> None:
        """Adds tiles at the end of the ego's way until enough of it is there, or no tile goes on."""
        while self._way_left() < LOOK_AHEAD and self.world_grows:
            first = self.start.lane_ids[int(np.asarray(self.state.route.lanes)[0, 0])][-1]
            exits = [one for one in find_exits(self.world, first) if self.tries[one.lane_ids[-1]] < MAX_TRIES]
            chosen = choose_exit(exits, self._rng(), yaw=self.yaw, way=self.way)
            if chosen is None:
                self.world_grows = False
                return
            key = jax.random.fold_in(self.tile_key, len(self.world.tiles))
            pose, number = chosen.pose, self.world.num_lanes
            world = extend_map(key, self.world, self.condition, x=pose.x, y=pose.y, yaw=pose.yaw, **self.outpainting)
            if world.num_lanes == number or not world.lane_by_id[chosen.lane_ids[-1]].successors:
                self.tries[chosen.lane_ids[-1]] += 1
            else:
                self.yaw, self.goal = pose.yaw, chosen.lane_ids[-1]
            self.world = world
            traffic = self._with_traffic(world)
            start = self._prepare(traffic)
            if blocking := vehicles_in_the_way(start) - self.seen:
                start = self._prepare(_without_agents(traffic, blocking))
            self._begin(start)
            self.seen |= set(world.agent_ids)

    def _begin(self, start: Start) -> None:
        """Starts from a moment on a new network."""
        self.start, self.number = start, self.number + 1
        self.row = start.log.object_ids.index(self.actor)
        self.state = start_state(
            jax.random.fold_in(self.key, self.number),
            start.network,
            start.agents,
            start.places,
            jnp.int32(self.row),
            lanes=_route_rows(start, self.row, self.goal),
            behavior=self.behavior,
        )

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
        ids, states, types = self.track.present(self.start, self.state.agents)
        fresh = [row for row, name in enumerate(world.agent_ids) if name not in self.seen]
        states = np.concatenate([states, world.agents[fresh]])
        ids = (*ids, *(world.agent_ids[row] for row in fresh))
        types = np.concatenate([types, world.agent_types[fresh]])
        ego = states[ids.index(self.actor), :2]
        near = np.hypot(*(states[:, :2] - ego).T) < AROUND
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


def vehicles_in_the_way(start: Start) -> set[str]:
    """Ids of vehicles that stand on a lane and follow none, or run against it: queues behind them would not end."""
    from scipy.spatial import KDTree

    log = start.log
    places = np.stack([start.agents.x, start.agents.y], -1)[: log.num_objects]
    near = KDTree(start.lanes.points[:, :2]).query(places)[0] < _IN_THE_WAY
    blocks = near & (start.places.lane[: log.num_objects] == NONE) & (log.object_types == AgentType.VEHICLE)
    return {log.object_ids[row] for row in np.flatnonzero(blocks)}


def _without_agents(map: Map, names: set[str]) -> Map:
    keep = np.array([name not in names for name in map.agent_ids], bool)
    return dataclasses.replace(
        map,
        agent_ids=tuple(name for name in map.agent_ids if name not in names),
        agents=map.agents[keep],
        agent_types=map.agent_types[keep],
    )


def _route_rows(start: Start, row: int, goal: str) -> Int[np.ndarray, " R"]:
    """Lanes of the network from that of the agent along successors to the one that holds lane ``goal``.

    Without a way to it, the agent's lane alone.
    """
    first = int(np.asarray(start.places.lane)[row])
    out = np.full(_ROUTE_LANES, NONE, np.int32)
    if first == NONE:
        return out
    came_from, queue = {first: NONE}, collections.deque([first])
    successors = np.asarray(start.network.successors)
    while queue:
        lane = queue.popleft()
        for following in successors[lane].tolist():
            if following >= 0 and following not in came_from:
                came_from[following] = lane
                queue.append(following)
    way = [next((lane for lane in came_from if goal in start.lane_ids[lane]), first)]
    while came_from[way[-1]] != NONE:
        way.append(came_from[way[-1]])
    way = way[::-1][:_ROUTE_LANES]
    out[: len(way)] = way
    return out
