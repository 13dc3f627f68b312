"""A pair of values, one for agents and one for lanes: latents, masks, noise, flags of known elements."""

from __future__ import annotations

from typing import Any

import jax

from scjax.scene.pytree import Replaceable, pytree


@pytree
class PerType(Replaceable):
    """Values of agents and of lanes; code maps over the pair with ``jax.tree.map`` instead of treating each type."""

    agents: Any
    lanes: Any


def generated_mask(masks: PerType, known: PerType | None) -> PerType:
    """True at the tokens that are generated: valid and not known."""
    return masks if known is None else jax.tree.map(lambda mask, flag: mask & ~flag, masks, known)
