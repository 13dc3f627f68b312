"""The two-kind PyTree: whatever there is once for agents and once for lanes (latents, masks, noise, given flags)."""

from __future__ import annotations

from typing import Any

import chex


@chex.dataclass(frozen=True, mappable_dataclass=False)
class Nodes:
    """Agents and lanes side by side; code maps over the pair with ``jax.tree.map`` instead of treating each kind."""

    agents: Any
    lanes: Any
