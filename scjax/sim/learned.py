"""The learned behavior: a network drives all agents by motion tokens of 0.2 s, given the return that they aim at."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.models.behavior.config import STEP
from scjax.models.behavior.network import behavior_network
from scjax.models.behavior.surroundings import Surroundings, surroundings_of
from scjax.models.behavior.traffic import Traffic
from scjax.models.behavior.vocabulary import apply_change
from scjax.scene import AgentType, Signal
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents, LanePlaces
from scjax.sim.behavior_weights import BehaviorWeights
from scjax.sim.border import has_left
from scjax.sim.constant_velocity import is_near
from scjax.sim.contacts import free_checks
from scjax.sim.road_network import NONE, RoadNetwork
from scjax.sim.route_traffic import first_motions, track_routes, traffic_of
from scjax.sim.routes import NUM_LANES, Routes, complete_routes, extend_routes, points_at, with_row

_SUBSTEPS = 2  # of a motion
_MARGIN = 20.0  # m beyond the lanes, where agents without a lane leave
_BRAKING = 6.0  # m/s^2, by which followers and leaders are taken to brake at most
_COMFORT = 4.0  # m/s^2, who would have to brake harder at a red signal drives on
_ROOM = 0.5  # m between bumpers at the end of it
_CANDIDATES = 8  # motions that are drawn
_INSIDE = -1.0  # m; bodies that overlap by more do not count: they did at the start


@pytree
class LearnedState(Replaceable):
    """Memory of ``LearnedBehavior`` for N agents.

    Attributes:
      routes: lanes that they follow, with their centers.
      motions, known: last motions, see ``Traffic``.
      rest: the second half of the motion under way, after the first.
      ground: height of the box center above the lane [m].
      is_parked: never moves.
      phase: number of the substep of the motion.
    """

    routes: Routes
    motions: Float[AnyArray, "N H 3"]
    known: Bool[AnyArray, "N H"]
    rest: Float[AnyArray, "N 3"]
    ground: Float[AnyArray, " N"]
    is_parked: Bool[AnyArray, " N"]
    phase: Int[AnyArray, ""]


@dataclasses.dataclass(frozen=True)
class LearnedBehavior:
    """Vehicles, cyclists and pedestrians as a network has seen them drive and walk; parked ones stay.

    Vehicles and cyclists have a route of lanes as for ``RouteFollower``, drawn at forks. The network knows it and is
    free to leave it. Agents leave at the end of lanes that lead out of the map.

    Attributes:
      weights: the network, from ``load_behavior``.
      tilt: added to the logits of the highest return, in equal steps from the lowest. The return is the room to other
        bodies in the next 3 s: 10 gives careful drivers, -10 such as seek others.
      temperature: of the motion tokens; below 1, likely ones become likelier.
      least: tokens with less than this share of the probability of the likeliest are not drawn.
      safe: leaves out motions after which a vehicle could not stop behind a leader that brakes, or at red. Of eight
        drawn motions, the first is taken that leads into no body within a second, if it is repeated and others go on
        as they do. Without it the network alone decides.
    """

    weights: BehaviorWeights
    tilt: float = 0.0
    temperature: float = 1.0
    least: float = 0.02
    safe: bool = True

    def start(self, key: Array, network: RoadNetwork, agents: Agents, places: LanePlaces) -> LearnedState:
        """See ``BehaviorModel``."""
        num, config = agents.x.shape[0], self.weights.config
        zeros = jnp.zeros(num)
        lanes = jnp.full((num, NUM_LANES), NONE).at[:, 0].set(places.lane)
        routes = Routes(lanes=lanes, along=places.along, lateral=zeros, lateral_speed=zeros, heading=zeros)
        routes = complete_routes(jax.random.split(key, NUM_LANES - 1), network, routes)
        motions = jnp.broadcast_to(first_motions(network, routes, agents)[:, None], (num, config.history, 3))
        _, _, z = points_at(network, routes, zeros)
        return LearnedState(
            routes=routes,
            motions=motions,
            known=jnp.zeros((num, config.history), bool),
            rest=jnp.zeros((num, 3)),
            ground=jnp.where(routes.has_route, agents.z - z, 0.0),
            is_parked=places.is_parked | (agents.kind == AgentType.STATIC),
            phase=jnp.int32(0),
        )

    def step(
        self,
        key: Array,
        network: RoadNetwork,
        state: LearnedState,
        agents: Agents,
        signals: Int[AnyArray, " S"],
        dt: float,
    ) -> tuple[LearnedState, Agents]:
        """See ``BehaviorModel``.

        Raises:
          ValueError: ``dt`` is not 0.1 s.
        """
        if abs(_SUBSTEPS * dt - STEP) > 1e-6:
            raise ValueError(f"dt is {dt} s: LearnedBehavior moves agents by {STEP / _SUBSTEPS} s")
        route_key, token_key = jax.random.split(key)
        # The phase is the same in all scenes of a batch, so that every other step skips the network.
        state, half = jax.lax.cond(
            state.phase == 0,
            lambda: self._decide(token_key, network, state, agents, signals),
            lambda: (state, state.rest),
        )
        moved = _moved(agents, half, dt)
        moves = agents.valid & ~state.is_parked
        names = ("x", "y", "heading", "speed")
        moved = agents.replace(**{n: jnp.where(moves, getattr(moved, n), getattr(agents, n)) for n in names})
        routes = extend_routes(route_key, network, track_routes(network, state.routes, moved))
        _, _, z = points_at(network, routes, jnp.zeros_like(moved.x))
        z = jnp.where(moves & routes.has_route, z + state.ground, moved.z)
        leaves = has_left(network, routes, moved) | ~is_near(network, moved.x, moved.y, _MARGIN)
        moved = moved.replace(z=z, valid=moved.valid & ~leaves)
        return state.replace(routes=routes, phase=(state.phase + 1) % _SUBSTEPS), moved

    def with_route(self, state: LearnedState, row: Int[AnyArray, ""], route: Routes) -> LearnedState:
        """See ``BehaviorModel``."""
        # Routes of others are followed by the rear axle; the next step finds the foot of the center.
        return state.replace(routes=with_row(state.routes, row, route))

    def _decide(
        self, key: Array, network: RoadNetwork, state: LearnedState, agents: Agents, signals: Int[AnyArray, " S"]
    ) -> tuple[LearnedState, Float[Array, "N 3"]]:
        """Draws the motions of all agents; the memory with them, and their first halves."""
        config, params = self.weights.config, jax.tree.map(jnp.asarray, self.weights.params)
        network_apply = behavior_network(config).apply
        traffic = traffic_of(network, state.routes, agents, state.motions, state.known, signals)
        seen = surroundings_of(traffic, None, min(config.neighbors, agents.x.shape[0]))
        return_key, motion_key = jax.random.split(key)
        agent = network_apply(params, seen.own, seen.others, seen.mask, method="read")
        tilt = self.tilt * jnp.linspace(0.0, 1.0, config.returns)[None]
        returns = jax.random.categorical(return_key, network_apply(params, agent, method="returns") + tilt)
        logits = network_apply(params, agent, returns, agents.kind, method="motions") / self.temperature
        base = jnp.asarray(state.motions)[:, 0]
        changes = jnp.asarray(self.weights.vocabulary)[jnp.clip(agents.kind, 0, len(self.weights.vocabulary) - 1)]
        kinds = jnp.broadcast_to(agents.kind[:, None], changes.shape[:2])
        choices = apply_change(jnp.broadcast_to(base[:, None], changes.shape), changes, kinds)
        logits = jnp.where(logits < logits.max(1, keepdims=True) + jnp.log(self.least), -jnp.inf, logits)
        if self.safe:
            logits = _safe_logits(logits, choices[..., 0], *_what_to_stop_for(traffic, seen))
        noisy = logits + jax.random.gumbel(motion_key, logits.shape)
        # The largest is a draw; the next ones are what is drawn where those before are ruled out.
        _, tokens = jax.lax.top_k(noisy, min(_CANDIDATES, config.motions) if self.safe else 1)
        row = jnp.zeros((len(tokens), 1), jnp.int32)
        if self.safe:
            tokens = jnp.concatenate([tokens, jnp.argmin(choices[..., 0], axis=1)[:, None]], 1)
            candidates = jnp.take_along_axis(choices, tokens[..., None], axis=1)
            still = jnp.where((agents.valid & ~state.is_parked)[:, None], base, 0.0)
            free = free_checks(agents, candidates, still, jnp.asarray(seen.near), jnp.asarray(seen.mask))
            is_drawn = jnp.isfinite(jnp.take_along_axis(noisy, tokens[:, :-1], axis=1))
            free = free.at[:, :-1].set(jnp.where(is_drawn, free[:, :-1], -1))
            row = jnp.argmax(free, axis=1)[:, None]
        token = jnp.take_along_axis(tokens, row, axis=1)[:, 0]
        motion = jnp.take_along_axis(choices, token[:, None, None], axis=1)[:, 0]
        moves = (agents.valid & ~state.is_parked)[:, None]
        motion = jnp.where(moves, motion, 0.0)
        first, rest = _halves(base, motion)
        motions = jnp.concatenate([motion[:, None], state.motions[:, :-1]], 1)
        known = jnp.concatenate([jnp.broadcast_to(moves, (len(moves), 1)), state.known[:, :-1]], 1)
        return state.replace(motions=motions, known=known, rest=rest), first


def _what_to_stop_for(traffic: Traffic, seen: Surroundings) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
    """Gap [m] and speed [m/s] of the leader, or of a red signal at which the agent can still stop."""
    drives = traffic.kind != AgentType.PEDESTRIAN
    gap = jnp.where(drives & (seen.lead_gap > _INSIDE), seen.lead_gap, jnp.inf)
    line = traffic.signal_gap - 0.5 * traffic.length
    speed = traffic.motions[:, 0, 0] / STEP
    stops = drives & (traffic.signal == Signal.STOP) & (line - _ROOM > speed * speed / (2 * _COMFORT))
    nearer = stops & (line < gap)
    return jnp.where(nearer, line, gap), jnp.where(nearer, 0.0, seen.lead_speed)


def _safe_logits(
    logits: Float[Array, "N V"], forward: Float[Array, "N V"], gap: Float[Array, " N"], lead_speed: Float[Array, " N"]
) -> Float[Array, "N V"]:
    """Logits without the motions after which an agent could not stop behind its leader; the shortest stays.

    Args:
      forward: distance that each motion covers [m].
      gap, lead_speed: to the leader, infinite without one [m], and its speed [m/s].
    """
    speed = jnp.maximum(lead_speed, 0.0)
    room = jnp.maximum(gap - _ROOM + speed * speed / (2 * _BRAKING), 0.0)
    # v^2 / 2b + v STEP = room
    most = _BRAKING * (jnp.sqrt(STEP * STEP + 2 * room / _BRAKING) - STEP) * STEP
    least = forward.min(1)
    most = jnp.maximum(most, least + 1e-4)[:, None]
    allowed = forward <= most
    # If the likely motions are all too long, the others come back.
    none = ~(allowed & jnp.isfinite(logits)).any(1, keepdims=True)
    longest = -10.0 * jnp.minimum(most - forward, 10.0) / STEP
    return jnp.where(allowed, jnp.where(none, longest, logits), -jnp.inf)


def _halves(base: Float[Array, "N 3"], motion: Float[Array, "N 3"]) -> tuple[Array, Array]:
    """Two motions that make up one, with a speed that changes steadily from that of the motion before."""
    first = 0.125 * base + 0.375 * motion
    first = jnp.clip(first, jnp.minimum(motion, 0.0), jnp.maximum(motion, 0.0))
    rest = motion - first
    cos, sin = jnp.cos(first[:, 2]), jnp.sin(first[:, 2])
    d_x, d_y = rest[:, 0], rest[:, 1]
    return first, jnp.stack([d_x * cos + d_y * sin, d_y * cos - d_x * sin, rest[:, 2]], -1)


def _moved(agents: Agents, motion: Float[Array, "N 3"], dt: float) -> Agents:
    """The agents after a motion of ``dt`` [s]."""
    cos, sin = jnp.cos(agents.heading), jnp.sin(agents.heading)
    walks = agents.kind == AgentType.PEDESTRIAN
    distance = jnp.where(walks, jnp.sqrt(motion[:, 0] ** 2 + motion[:, 1] ** 2), jnp.maximum(motion[:, 0], 0.0))
    return agents.replace(
        x=agents.x + motion[:, 0] * cos - motion[:, 1] * sin,
        y=agents.y + motion[:, 0] * sin + motion[:, 1] * cos,
        heading=agents.heading + motion[:, 2],
        speed=distance / dt,
    )
