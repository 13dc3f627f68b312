"""Agents that keep their speed and heading: a baseline."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents, LanePlaces
from scjax.sim.road_network import RoadNetwork
from scjax.sim.routes import Routes


@dataclasses.dataclass(frozen=True)
class ConstantVelocity:
    """Every agent goes straight on; parked ones stay. Agents leave 20 m beyond the last lane."""

    margin: float = 20.0

    def start(self, key: Array, network: RoadNetwork, agents: Agents, places: LanePlaces) -> Bool[AnyArray, " N"]:
        """Which agents are parked."""
        return places.is_parked

    def step(
        self,
        key: Array,
        network: RoadNetwork,
        state: Bool[AnyArray, " N"],
        agents: Agents,
        signals: Int[AnyArray, " S"],
        dt: float,
    ) -> tuple[Bool[AnyArray, " N"], Agents]:
        """See ``BehaviorModel``."""
        distance = jnp.where(state, 0.0, agents.speed * dt)
        x = agents.x + distance * jnp.cos(agents.heading)
        y = agents.y + distance * jnp.sin(agents.heading)
        return state, agents.replace(x=x, y=y, valid=agents.valid & is_near(network, x, y, self.margin))

    def with_route(self, state: Bool[AnyArray, " N"], row: Int[AnyArray, ""], route: Routes) -> Bool[AnyArray, " N"]:
        """See ``BehaviorModel``: no route is remembered."""
        return state


def is_near(network: RoadNetwork, x, y, margin: float):
    """Whether places are within ``margin`` [m] of the rectangle around all lanes [N]."""
    inside_x = (x > network.x.min() - margin) & (x < network.x.max() + margin)
    return inside_x & (y > network.y.min() - margin) & (y < network.y.max() + margin)
