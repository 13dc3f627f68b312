"""What every behavior model offers, so that roll-outs do not know which one drives.

A new model is one file with a frozen dataclass and one line in ``scjax.sim.behaviors``.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from jaxtyping import Array, Int

from scjax.scene.scene import AnyArray
from scjax.sim.agents import Agents, LanePlaces
from scjax.sim.road_network import RoadNetwork
from scjax.sim.routes import Routes

State = Any  # a PyTree of arrays


@runtime_checkable
class BehaviorModel(Protocol):
    """Moves all agents of a scene by one step; pure, jitted by the roll-out, and hashable."""

    def start(self, key: Array, network: RoadNetwork, agents: Agents, places: LanePlaces) -> State:
        """The model's memory at time 0."""
        ...

    def step(
        self, key: Array, network: RoadNetwork, state: State, agents: Agents, signals: Int[AnyArray, " S"], dt: float
    ) -> tuple[State, Agents]:
        """Memory and agents ``dt`` seconds later.

        Args:
          signals: ``Signal`` of every signal now.
        """
        ...

    def with_route(self, state: State, row: Int[AnyArray, ""], route: Routes) -> State:
        """The memory when a policy has driven agent ``row``, which is now on ``route`` (N = 1)."""
        ...
