"""LogTracks -> motion tokens from the agent's own position, with what it knows at each step; jitted, one log."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from scjax.models.behavior.config import STEP
from scjax.models.behavior.traffic import Traffic
from scjax.models.behavior.vocabulary import apply_change, token_errors
from scjax.scene import AgentType
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.road_network import RoadNetwork
from scjax.sim.route_traffic import first_motions, track_routes, traffic_of
from scjax.sim.routes import Routes
from scjax.train.motion.tracks import BLOCK, LogTracks

_NUCLEUS, _TEMPERATURE = 0.95, 0.008  # of the choice of tokens; the second [m]
_RETURN = 0.82  # of the distance from the track that is left after a step
_STANDS, _STAYS = 0.2, 0.3  # m/s and m; noise of standing vehicles in recordings
_LOST = 3.0  # m from the track, at which an agent starts again on it


@pytree
class Rolls(Replaceable):
    """N agents over T steps along the tokens that come nearest to their tracks.

    Attributes:
      traffic: what is known at each step; its ``motions`` are those before it, ``known`` as in ``Traffic``.
      fresh: the last motion as it is taken where the past is not known.
      target: the next motion.
      has_target: whether the agent has one.
    """

    traffic: Traffic
    fresh: Float[AnyArray, "T N 3"]
    target: Float[AnyArray, "T N 3"]
    has_target: Bool[AnyArray, "T N"]


@pytree
class Noise(Replaceable):
    """How far rolls stray from the tracks: deviations of sudden shifts to the left [m], turns [rad], and speeds [m/s].

    ``share`` is the probability of one at each step.
    """

    share: float
    left: float
    turn: float
    speed: float


NO_NOISE = Noise(share=0.0, left=0.0, turn=0.0, speed=0.0)
NOISE = Noise(share=0.06, left=0.25, turn=0.03, speed=0.8)


@pytree
class _Carry(Replaceable):
    """State of the scan: poses, last motions and routes."""

    x: Array
    y: Array
    heading: Array
    valid: Array
    motions: Array
    known: Array
    routes: Routes


def roll_tracks(
    key: Array, tracks: LogTracks, vocabulary: Float[np.ndarray, "C V 3"], history: int, noise: Noise = NO_NOISE
) -> Rolls:
    """The rolls of a log: tokens are drawn from the nearest ones, from where the last token has led."""
    steps = len(tracks.x)
    lanes, along = (np.repeat(values, BLOCK, axis=0)[:steps] for values in (tracks.lanes, tracks.along))
    signals = tracks.signals if tracks.signals.shape[1] else np.zeros((steps, 1), np.int32)
    wide = np.zeros((steps, -(-signals.shape[1] // 64) * 64), np.int32)
    wide[:, : signals.shape[1]] = signals
    per_step = {name: getattr(tracks, name) for name in ("x", "y", "heading", "speed", "valid")}
    per_step |= {"lanes": lanes, "along": along, "signals": wide, "starts": np.arange(steps) % BLOCK == 0}
    fixed = {name: getattr(tracks, name) for name in ("length", "width", "kind")}
    rolls = _roll(key, tracks.network, per_step, fixed, vocabulary, noise, history=history)
    return jax.tree.map(np.asarray, rolls)


@functools.partial(jax.jit, static_argnames=("history",))
def _roll(
    key: Array,
    network: RoadNetwork,
    per_step: dict[str, Array],
    fixed: dict[str, Array],
    vocabulary: Array,
    noise: Noise,
    *,
    history: int,
) -> Rolls:
    num = per_step["x"].shape[1]
    zeros = jnp.zeros(num)
    routes = Routes(
        lanes=jnp.asarray(per_step["lanes"][0]),
        along=jnp.asarray(per_step["along"][0]),
        lateral=zeros,
        lateral_speed=zeros,
        heading=zeros,
    )
    carry = _Carry(
        x=zeros, y=zeros, heading=zeros, valid=zeros > 0, routes=routes,
        motions=jnp.zeros((num, history, 3)), known=jnp.zeros((num, history), bool),
    )  # fmt: skip

    def step(carry: _Carry, inputs: tuple[Array, dict[str, Array], dict[str, Array]]) -> tuple[_Carry, Rolls]:
        number, now, then = inputs
        return _step(jax.random.fold_in(key, number), network, carry, now, then, fixed, vocabulary, noise)

    after = jax.tree.map(lambda values: jnp.concatenate([values[1:], values[-1:]]), per_step)
    after["valid"] = after["valid"].at[-1].set(False)
    _, rolls = jax.lax.scan(step, carry, (jnp.arange(len(per_step["x"])), per_step, after))
    return rolls


def _step(
    key: Array,
    network: RoadNetwork,
    carry: _Carry,
    now: dict[str, Array],
    then: dict[str, Array],
    fixed: dict[str, Array],
    vocabulary: Array,
    noise: Noise,
) -> tuple[_Carry, Rolls]:
    """What agents know now, their next token, and where it leads them."""
    noise_key, token_key = jax.random.split(key)
    kind, length, width = fixed["kind"], fixed["length"], fixed["width"]
    lost = (carry.x - now["x"]) ** 2 + (carry.y - now["y"]) ** 2 > _LOST**2
    appears = now["valid"] & (~carry.valid | lost)
    x, y = jnp.where(appears, now["x"], carry.x), jnp.where(appears, now["y"], carry.y)
    heading = jnp.where(appears, now["heading"], carry.heading)
    routes = carry.routes
    replaces = appears | now["starts"]
    routes = routes.replace(
        lanes=jnp.where(replaces[:, None], now["lanes"], routes.lanes),
        along=jnp.where(replaces, now["along"], routes.along),
    )
    zeros = jnp.zeros_like(x)
    agents = Agents(
        x=x, y=y, z=zeros, heading=heading, speed=now["speed"], valid=now["valid"], length=length, width=width,
        height=zeros, kind=kind, entries=jnp.zeros_like(kind),
    )  # fmt: skip
    left, turn, faster = _kicks(noise_key, now, kind, noise)
    agents = agents.replace(
        x=x - left * jnp.sin(heading), y=y + left * jnp.cos(heading), heading=heading + turn,
    )  # fmt: skip
    routes = track_routes(network, track_routes(network, routes, agents), agents)
    fresh = first_motions(network, routes, agents)
    motions = jnp.where(appears[:, None, None], fresh[:, None], carry.motions)
    known = carry.known & ~appears[:, None]
    base = motions[:, 0].at[:, 0].add(STEP * faster)
    base = base.at[:, 0].set(jnp.where(kind == AgentType.PEDESTRIAN, base[:, 0], jnp.maximum(base[:, 0], 0.0)))
    motions = motions.at[:, 0].set(base)
    traffic = traffic_of(network, routes, agents, motions, known, now["signals"])
    aim = _aim(agents, now, then)
    errors = token_errors(vocabulary, base, aim, length, width, kind)
    token = _nucleus(token_key, errors)
    change = vocabulary[jnp.clip(kind, 0, len(vocabulary) - 1), token]
    motion = apply_change(base, change, kind)
    has_target = now["valid"] & then["valid"] & (errors.min(1) < 0.5)
    motion = jnp.where(has_target[:, None], motion, 0.0)
    cos, sin = jnp.cos(agents.heading), jnp.sin(agents.heading)
    carry = _Carry(
        x=jnp.asarray(agents.x + motion[:, 0] * cos - motion[:, 1] * sin),
        y=jnp.asarray(agents.y + motion[:, 0] * sin + motion[:, 1] * cos),
        heading=jnp.asarray(agents.heading + motion[:, 2]),
        valid=has_target,
        motions=jnp.concatenate([motion[:, None], motions[:, :-1]], 1),
        known=jnp.concatenate([has_target[:, None], known[:, :-1]], 1),
        routes=routes,
    )
    return carry, Rolls(traffic=traffic, fresh=fresh, target=motion, has_target=has_target)


def _kicks(key: Array, now: dict[str, Array], kind: Int[Array, " N"], noise: Noise) -> tuple[Array, Array, Array]:
    """Sudden shifts, turns and changes of speed of some moving vehicles and cyclists [N]."""
    share_key, *keys = jax.random.split(key, 4)
    draws = jax.random.uniform(share_key, kind.shape)
    moves = (now["speed"] > 1.0) & (kind != AgentType.PEDESTRIAN)
    kicked = (draws < noise.share) & moves & now["valid"]
    shift, turn, speed = (jnp.where(kicked, jax.random.normal(one, kind.shape), 0.0) for one in keys)
    return noise.left * shift, noise.turn * turn, noise.speed * speed


def _aim(agents: Agents, now: dict[str, Array], then: dict[str, Array]) -> Float[Array, "N 3"]:
    """The motion to where the track goes, beside it by what is left of the present distance from it."""
    cos, sin = jnp.cos(now["heading"]), jnp.sin(now["heading"])
    d_x, d_y = agents.x - now["x"], agents.y - now["y"]
    ahead, left = (d_x * cos + d_y * sin) * _RETURN, (d_y * cos - d_x * sin) * _RETURN
    turn = _wrap(agents.heading - now["heading"]) * _RETURN
    cos, sin = jnp.cos(then["heading"]), jnp.sin(then["heading"])
    x, y = then["x"] + ahead * cos - left * sin, then["y"] + ahead * sin + left * cos
    heading = then["heading"] + turn
    d_x, d_y = x - agents.x, y - agents.y
    cos, sin = jnp.cos(agents.heading), jnp.sin(agents.heading)
    motion = jnp.stack([d_x * cos + d_y * sin, d_y * cos - d_x * sin, _wrap(heading - agents.heading)], -1)
    stands = (now["speed"] < _STANDS) & (then["speed"] < _STANDS) & (agents.kind != AgentType.PEDESTRIAN)
    stands = stands & (d_x * d_x + d_y * d_y < _STAYS**2)
    return jnp.where(stands[:, None], 0.0, motion)


def _nucleus(key: Array, errors: Float[Array, "N V"]) -> Int[Array, " N"]:
    """Tokens drawn from the nearest, which have most of the probability."""
    logits = -errors / _TEMPERATURE
    values, order = jax.lax.top_k(logits, min(16, errors.shape[1]))
    shares = jax.nn.softmax(values, axis=1)
    before = jnp.cumsum(shares, axis=1) - shares
    choice = jax.random.categorical(key, jnp.where(before < _NUCLEUS, values, -jnp.inf))
    return jnp.take_along_axis(order, choice[:, None], axis=1)[:, 0]


def _wrap(angle: Any) -> Array:
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi
