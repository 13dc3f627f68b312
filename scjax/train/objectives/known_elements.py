"""Which elements of training scenes the denoiser is given clean, so that it learns to complete scenes."""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from scjax.scene import TILE_SIZE, AnyArray, Scene
from scjax.scene.per_type import PerType

_AGENT_FIELDS = ("agents", "agent_types", "agent_mask", "agent_known")
_LANE_FIELDS = ("lanes", "lane_mask", "lane_known", "signals")


@dataclasses.dataclass(frozen=True)
class KnownShares:
    """Shares of training scenes with known elements, besides the known halves of partitioned scenes.

    Attributes:
      lanes: all lanes are known; in half of these scenes some agents too, the ego among them.
      region: all elements on one side of a random line are known, and the ego.
    """

    lanes: float
    region: float


def draw_known(keys: Array, scene: Scene, behind: PerType, shares: KnownShares) -> tuple[Scene, PerType, PerType]:
    """Draws what is known of each scene, and puts known tokens before the others, as in sampling.

    Args:
      keys: one per scene [B].
      behind: the known halves of partitioned scenes (``elements_behind``), True or False [B, tokens] per type.

    Returns:
      The scenes; known tokens; and tokens that must be encoded as if the others were not there, True or False
      [B, tokens] per type.
    """
    known, apart = jax.vmap(functools.partial(_draw_one, shares=shares))(keys, scene, behind)
    return _known_first(scene, known, apart)


def _draw_one(key: Array, scene: Scene, behind: PerType, shares: KnownShares) -> tuple[PerType, PerType]:
    """Of one scene, what is known, and what must be encoded as if the rest were not there."""
    choice = jax.random.uniform(jax.random.fold_in(key, 0))
    all_lanes, region = choice < shares.lanes, (choice >= shares.lanes) & (choice < shares.lanes + shares.region)
    side = _side_of_line(jax.random.fold_in(key, 1), scene)
    apart = PerType(agents=behind.agents | (region & side.agents), lanes=behind.lanes | (region & side.lanes))
    some = _some_agents(jax.random.fold_in(key, 2), scene.agent_mask)
    known = PerType(agents=apart.agents | (all_lanes & some), lanes=apart.lanes | (all_lanes & scene.lane_mask))
    return known, apart


def _known_first(scene: Scene, known: PerType, apart: PerType) -> tuple[Scene, PerType, PerType]:
    agents, lanes = _order(known.agents, scene.agent_mask), _order(known.lanes, scene.lane_mask)
    fields = {name: _take(getattr(scene, name), agents) for name in _AGENT_FIELDS}
    fields |= {name: _take(getattr(scene, name), lanes) for name in _LANE_FIELDS}
    links = jnp.swapaxes(_take(scene.links, lanes), -1, -2)
    fields["links"] = jnp.swapaxes(_take(links, lanes), -1, -2)
    known, apart = (PerType(agents=_take(one.agents, agents), lanes=_take(one.lanes, lanes)) for one in (known, apart))
    return scene.replace(**fields), known, apart


def _order(known: Bool[Array, "b n"], mask: Bool[AnyArray, "b n"]) -> Int[Array, "b n"]:
    return jnp.argsort(jnp.where(mask, jnp.where(known, 0, 1), 2), axis=-1, stable=True)


def _take(values: AnyArray, order: Int[Array, "b n"]) -> Array:
    values = jnp.asarray(values)
    return jnp.take_along_axis(values, order.reshape(*order.shape, *(1,) * (values.ndim - 2)), axis=1)


def _some_agents(key: Array, mask: Bool[AnyArray, " n"]) -> Bool[Array, " n"]:
    """In half of the scenes none, in the others the ego and a random share of the rest."""
    share = jax.random.uniform(jax.random.fold_in(key, 0))
    drawn = jax.random.uniform(jax.random.fold_in(key, 1), mask.shape) < 2 * share - 1
    return drawn.at[0].set(True) & (share > 0.5) & mask


def _side_of_line(key: Array, scene: Scene) -> PerType:
    """Elements left of a line through a random place in a random direction, and the ego."""
    draws = jax.random.uniform(key, (3,))
    angle, place = 2 * np.pi * draws[0], (draws[1:] - 0.5) * TILE_SIZE
    normal = jnp.stack([jnp.cos(angle), jnp.sin(angle)])

    def side(points: AnyArray) -> Array:
        return ((points - place[None]) * normal[None]).sum(-1) > 0

    middle = scene.lanes.shape[-2] // 2 - 1
    is_left = PerType(agents=side(scene.agents[:, :2]), lanes=side(scene.lanes[:, middle, :2]))
    return PerType(agents=is_left.agents.at[0].set(True) & scene.agent_mask, lanes=is_left.lanes & scene.lane_mask)
