"""What the vision network of the package sees in a picture, and scenes that are made to agree with it."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from jaxtyping import Float

from scjax.generate.seen_agents import SeenAgents, held_scene, seen_agents
from scjax.generate.seen_lanes import SeenLanes, seen_lanes, shift_to_seen
from scjax.generate.seen_space import SeenSpace, move_misplaced
from scjax.scene import AgentType, Scene


@dataclasses.dataclass(frozen=True, eq=False)
class SeenPicture:
    """Agents, lanes and space of a picture.

    Attributes:
      cells: the tokens of the picture in their places.
      views: those of changed views of it (``seen_views``); None: not known.
    """

    cells: Float[np.ndarray, "width rows columns"]
    views: Float[np.ndarray, "changes cells width"] | None = None

    @functools.cached_property
    def agents(self) -> SeenAgents:
        """Agents that are seen, without vehicles where the picture shows ground."""
        seen = seen_agents(self._tokens, self.views)
        boxes = np.asarray(held_scene(seen, np.zeros(1 + len(seen.types)), 0).agents)[1:]
        kept = (seen.types != AgentType.VEHICLE) | ~self.space.shows_ground(boxes)
        return SeenAgents(*(values[kept] for values in seen))

    @functools.cached_property
    def lanes(self) -> SeenLanes:
        """Middles of lanes that are seen."""
        return seen_lanes(self._tokens)

    @functools.cached_property
    def space(self) -> SeenSpace:
        """Depth of every cell."""
        return SeenSpace.of_cells(self.cells)

    @property
    def _tokens(self) -> Float[np.ndarray, "cells width"]:
        return self.cells.reshape(len(self.cells), -1).T

    def fit(self, scene: Scene, first: int, keeps_number: bool) -> Scene:
        """The scene with its lanes shifted onto those that are seen, and no vehicle where none is seen.

        Args:
          scene: single, unpadded, in the forward window.
          first: number of the agents that stay: the ego and those that are seen.
          keeps_number: whether no agent may be left out.
        """
        return move_misplaced(shift_to_seen(scene, first, self.lanes), first, self.space, keeps_number)
