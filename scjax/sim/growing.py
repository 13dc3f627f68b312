"""``scjax.drive_on``: a closed loop on a map that grows ahead of the driven agent."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from scjax.generate.arguments import sampling_key
from scjax.generate.conditions import Condition
from scjax.outpainting.outpaint import MAX_LENGTH, outpaint_steps
from scjax.scene import Map, Scene, map_to_log, scene_to_map
from scjax.scene.arguments import finite_number
from scjax.sim.behavior import BehaviorModel
from scjax.sim.closed_loop import DrivingTerms
from scjax.sim.drive import DriveResult, actor_row, drive_segment, start_state, terms_on_host
from scjax.sim.policies import Policy, RoutePolicy
from scjax.sim.preparation import Start, prepare
from scjax.sim.road_network import NONE
from scjax.sim.route_follower import RouteFollower
from scjax.sim.simulate import MAX_SECONDS, TIME_STEP, key_seed, padded_signals
from scjax.sim.track_log import TrackLog

SEGMENT = 20  # steps between two looks at what is left of the way
LOOK_AHEAD = 90.0  # m of the way that must be there
AROUND = 200.0  # m from the driven agent, within which traffic moves
_ROUTE_LANES = 32


def drive_on(
    key: Any,
    source: Scene | Map,
    policy: Policy | None = None,
    *,
    condition: Condition | str | None = None,
    policy_state: Any = None,
    seconds: float = 60.0,
    length: float = MAX_LENGTH,
    behavior: BehaviorModel | None = None,
    **outpainting: Any,
) -> tuple[DriveResult, Map]:
    """As ``scjax.drive``, and the map grows by tiles whenever less than 90 m of the ego's way are left.

    Agents of new tiles join the traffic. Only agents within 200 m of the ego move; those farther away are gone. The
    ego follows the route of the map, straight ahead by default.

    Args:
      condition: what the new tiles show.
      length: at which the map stops to grow [m].
      outpainting: further options of ``scjax.outpaint``, such as ``candidates`` and ``route``.

    Returns:
      What happened, on the lanes of the final map, and that map.

    Raises:
      ValueError: as ``scjax.drive`` and ``scjax.outpaint``.
    """
    *_, last = drive_on_steps(
        key,
        source,
        policy,
        condition=condition,
        policy_state=policy_state,
        seconds=seconds,
        length=length,
        behavior=behavior,
        **outpainting,
    )
    return last


def drive_on_steps(
    key: Any,
    source: Scene | Map,
    policy: Policy | None = None,
    *,
    condition: Condition | str | None = None,
    policy_state: Any = None,
    seconds: float = 60.0,
    length: float = MAX_LENGTH,
    behavior: BehaviorModel | None = None,
    **outpainting: Any,
) -> Iterator[tuple[DriveResult, Map]]:
    """As ``drive_on``, but gives what has happened so far every two seconds."""
    seconds = finite_number(seconds, "seconds", TIME_STEP, MAX_SECONDS)
    key = sampling_key(key)
    world = scene_to_map(source) if isinstance(source, Scene) else source
    tiles = outpaint_steps(jax.random.fold_in(key, 1), world, condition, length=length, **outpainting)
    run = _GrowingDrive(
        key=jax.random.fold_in(key, 2),
        tiles=tiles,
        world=next(tiles),
        policy=RoutePolicy() if policy is None else policy,
        policy_state=policy_state,
        behavior=RouteFollower() if behavior is None else behavior,
    )
    steps = round(seconds / TIME_STEP)
    while run.track.num_steps <= steps and not run.has_ended:
        run.advance(min(SEGMENT, steps + 1 - run.track.num_steps))
        yield run.result()


class _GrowingDrive:
    """The loop with its present map."""

    def __init__(self, key: Array, tiles: Iterator[Map], world: Map, policy: Policy, policy_state: Any, behavior):
        self.key, self.tiles, self.world = key, tiles, world
        self.policy, self.policy_state, self.behavior = policy, policy_state, behavior
        self.clock, self.number, self.has_ended = 0.0, 0, False
        start = self._prepare(world)
        self.row = actor_row(start, None)
        self.actor = start.log.object_ids[self.row]
        self.track = TrackLog(start)
        self.terms: list[dict[str, np.ndarray]] = []
        self.seen = set(world.agent_ids)
        self._begin(start)

    def result(self) -> tuple[DriveResult, Map]:
        """What has happened so far, and the map."""
        log = self.track.log(map_to_log(self.world), self.actor, TIME_STEP)
        terms = {name: np.concatenate([one[name] for one in self.terms]) for name in DrivingTerms._fields}
        return DriveResult(log, self.actor, terms), self.world

    def advance(self, steps: int) -> None:
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
        """Adds tiles until enough of the way is there, or the map does not grow any more."""
        while self._way_left() < LOOK_AHEAD:
            world = next(self.tiles, None)
            if world is None:
                break
            self.world = world
            self._begin(self._prepare(self._with_traffic(world)))
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
            _route_rows(start, self.row, self.world),
            behavior=self.behavior,
        )

    def _way_left(self) -> float:
        """What is left of the ego's way [m]."""
        lanes = np.asarray(self.state.route.lanes[0])
        lengths = np.asarray(self.start.network.length)[lanes[lanes >= 0]]
        return float(lengths.sum() - self.state.route.along[0])

    def _prepare(self, world: Map) -> Start:
        """The start on the lanes near the ego; signals that were there keep their phases."""
        start = prepare(world, 0, np.random.default_rng(key_seed(self.key)))
        old = getattr(self, "start", None)
        if old is None:
            return start
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


def _route_rows(start: Start, row: int, world: Map) -> Int[np.ndarray, " R"]:
    """The ego's lanes in the network: along successors to the last lane of the map's route that can be reached."""
    rows = {name: row for row, names in enumerate(start.lane_ids) for name in names}
    first = int(np.asarray(start.places.lane)[row])
    out = np.full(_ROUTE_LANES, NONE, np.int32)
    goals = [rows[name] for route in world.routes[:1] for name in route.lane_ids if name in rows]
    if first == NONE:
        return out
    came_from, queue = {first: NONE}, collections.deque([first])
    successors = np.asarray(start.network.successors)
    while queue:
        lane = queue.popleft()
        for following in successors[lane]:
            if following >= 0 and int(following) not in came_from:
                came_from[int(following)] = lane
                queue.append(int(following))
    goal = next((lane for lane in reversed(goals) if lane in came_from), first)
    way = [goal]
    while came_from[way[-1]] != NONE:
        way.append(came_from[way[-1]])
    way = way[::-1][:_ROUTE_LANES]
    out[: len(way)] = way
    return out
