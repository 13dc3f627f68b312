"""What a driving policy sees. Jitted, one scene."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from scjax.scene import Signal
from scjax.scene.pytree import Replaceable, pytree
from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents
from scjax.sim.road_network import RoadNetwork
from scjax.sim.routes import AXLE_SHARE, Routes, lane_starts, way_points

NUM_NEAREST = 16  # agents that a policy sees
ROUTE_DISTANCES = np.arange(0.0, 60.0, 3.0).astype(np.float32)  # m ahead of the center
FAR = 100.0  # m; distance of a stop line that is not there


@pytree
class Observation(Replaceable):
    """The surroundings of a driven agent, in its own frame: x forward, y left.

    Attributes:
      speed: [m/s]. size: length and width [m].
      lateral, heading: offset to the left of the route [m] and direction relative to it [rad].
      route: x, y of points of the route [m] and the speed of the road there [m/s].
      route_mask: False behind the end of the route.
      stop_distance: from the front to the next stop line at red or amber [m]; 100 without one.
      agents: x, y [m], cos, sin of the heading, speed [m/s], length, width [m] of the nearest, the nearest first.
      agent_types: ``AgentType``.
      agent_mask: False where there are fewer agents.
    """

    speed: Float[AnyArray, "*b"]
    size: Float[AnyArray, "*b 2"]
    lateral: Float[AnyArray, "*b"]
    heading: Float[AnyArray, "*b"]
    route: Float[AnyArray, "*b 20 3"]
    route_mask: Bool[AnyArray, "*b 20"]
    stop_distance: Float[AnyArray, "*b"]
    agents: Float[AnyArray, "*b 16 7"]
    agent_types: Int[AnyArray, "*b 16"]
    agent_mask: Bool[AnyArray, "*b 16"]


def observe(
    network: RoadNetwork, agents: Agents, route: Routes, signals: Int[AnyArray, " S"], row: Int[AnyArray, ""]
) -> Observation:
    """What agent ``row`` sees, whose route is ``route`` (N = 1)."""
    x, y, heading = agents.x[row], agents.y[row], agents.heading[row]
    cos, sin = jnp.cos(heading), jnp.sin(heading)

    def local(at_x, at_y):
        return (at_x - x) * cos + (at_y - y) * sin, (at_y - y) * cos - (at_x - x) * sin

    length = agents.length[row]
    way = way_points(network, route, (AXLE_SHARE * length + jnp.asarray(ROUTE_DISTANCES))[None])
    way_x, way_y = local(way.x[0], way.y[0])
    signal = network.signal[route.lanes[0]]
    state = jnp.where((route.lanes[0] >= 0) & (signal >= 0), signals[signal], Signal.UNKNOWN)
    front = (0.5 + AXLE_SHARE) * length
    stop = lane_starts(network, route)[0, :-1] - route.along[0] - front
    stops = ((state == Signal.STOP) | (state == Signal.CAUTION)) & (stop > -0.5)
    distance = jnp.hypot(agents.x - x, agents.y - y)
    others = agents.valid & (jnp.arange(agents.x.shape[0]) != row)
    nearest = jnp.argsort(jnp.where(others, distance, jnp.inf))[:NUM_NEAREST]
    seen = others[nearest]
    near_x, near_y = local(agents.x[nearest], agents.y[nearest])
    turn = agents.heading[nearest] - heading
    columns = (near_x, near_y, jnp.cos(turn), jnp.sin(turn), agents.speed[nearest])
    columns = (*columns, agents.length[nearest], agents.width[nearest])
    return Observation(
        speed=agents.speed[row],
        size=jnp.stack([length, agents.width[row]]),
        lateral=route.lateral[0],
        heading=route.heading[0],
        route=jnp.where(way.inside[0][:, None], jnp.stack([way_x, way_y, way.limit[0]], -1), 0.0),
        route_mask=way.inside[0],
        stop_distance=jnp.where(stops, jnp.maximum(stop, 0.0), FAR).min(),
        agents=jnp.where(seen[:, None], jnp.stack(columns, -1), 0.0),
        agent_types=jnp.where(seen, agents.kind[nearest], 0),
        agent_mask=seen,
    )
