"""The two-kind PyTree: whatever there is once for agents and once for lanes (latents, masks, noise, given flags)."""

from __future__ import annotations

from typing import Any

import jax

from scjax.scene.pytree import Replaceable, pytree


@pytree
class PerType(Replaceable):
    """Agents and lanes side by side; code maps over the pair with ``jax.tree.map`` instead of treating each kind."""

    agents: Any
    lanes: Any


def generated_mask(masks: PerType, given: PerType | None) -> PerType:
    """True at the tokens that are made: valid and not given."""
    return masks if given is None else jax.tree.map(lambda mask, flag: mask & ~flag, masks, given)
