"""Sizes of the behavior network."""

from __future__ import annotations

import dataclasses
from typing import Any

CLASSES = 3
"""Agents with a vocabulary of their own: vehicles, pedestrians, cyclists, numbered as ``AgentType``."""
STEP = 0.2
"""Time of one motion [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class BehaviorConfig:
    """Sizes of the network and of its vocabulary.

    Attributes:
      width: hidden width of an agent and of each of its neighbors.
      layers, heads: layers of attention to the neighbors, and heads in each.
      neighbors: agents that an agent sees; those nearest to its way.
      history: past motions that it knows, of 0.2 s each.
      motions: size of the vocabulary of each class.
      returns: bins of the clearance that is the return.
    """

    width: int = 64
    layers: int = 2
    heads: int = 4
    neighbors: int = 12
    history: int = 5
    motions: int = 256
    returns: int = 8

    def __post_init__(self):
        for field in dataclasses.fields(self):
            least = 0 if field.name == "layers" else 2 if field.name in ("motions", "returns") else 1
            if getattr(self, field.name) < least:
                value = getattr(self, field.name)
                raise ValueError(f"BehaviorConfig.{field.name} must be at least {least}, not {value}")
        if self.width % self.heads:
            raise ValueError(f"BehaviorConfig.width {self.width} must be a multiple of heads {self.heads}")

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> BehaviorConfig:
        """The config with the fields of a JSON document."""
        return cls(**fields)
