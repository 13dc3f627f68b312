"""What the vision network of the package sees in a picture, and scenes that are made to agree with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from scjax.generate.seen_lanes import SeenLanes, seen_lanes, shift_to_seen
from scjax.generate.seen_space import SeenSpace, move_misplaced
from scjax.scene import Scene


class SeenPicture(NamedTuple):
    """Space and lanes of a picture."""

    space: SeenSpace
    lanes: SeenLanes

    @classmethod
    def of_cells(cls, cells: Float[np.ndarray, "width rows columns"]) -> SeenPicture:
        """From the tokens of a picture in their places."""
        return cls(SeenSpace.of_cells(cells), seen_lanes(cells.reshape(len(cells), -1).T))

    def fit(self, scene: Scene, first: int, keeps_number: bool) -> Scene:
        """The scene with its lanes shifted onto those that are seen, and no vehicle where none is seen.

        Args:
          scene: single, unpadded, in the forward window.
          first: number of the agents that stay: the ego and those that are seen.
          keeps_number: whether no agent may be left out.
        """
        return move_misplaced(shift_to_seen(scene, first, self.lanes), first, self.space, keeps_number)
