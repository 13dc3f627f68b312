"""How far lanes that follow each other may be apart."""

from __future__ import annotations

import dataclasses

JOIN_DISTANCE = 0.05  # m between an end and a start that are one point, where the source has no topology
MAX_JOIN_DISTANCE = 1.0  # m; recorded connections that are open by more are refused


@dataclasses.dataclass(frozen=True)
class JoinOptions:
    """How far an end and a start may be apart.

    Attributes:
      distance: inferred connections, in sources without topology [m]; at most ``MAX_JOIN_DISTANCE``.

    Raises:
      ValueError: the distance is out of range.
    """

    distance: float = JOIN_DISTANCE

    def __post_init__(self):
        if not 0 < self.distance <= MAX_JOIN_DISTANCE:
            raise ValueError(f"join_distance is {self.distance} m: it must be above 0 and at most {MAX_JOIN_DISTANCE}")
