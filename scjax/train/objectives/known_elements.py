"""Which elements of training scenes the denoiser is given clean, so that it learns to complete scenes."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from scjax.nn import random
from scjax.scene import TILE_SIZE, AnyArray, Scene
from scjax.scene.partition import elements_behind
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


def draw_known(keys: Array, scene: Scene, shares: KnownShares) -> tuple[Scene, PerType, PerType]:
    """Draws what is known of each scene, and puts known tokens before the others, as in sampling.

    Returns:
      The scenes; known tokens; and tokens that must be encoded as if the others were not there, True or False
      [B, tokens] per type.
    """
    behind = elements_behind(scene)
    choice = random.uniform(random.fold_in(keys, 0), scene.crop.shape)[:, None]
    all_lanes, region = choice < shares.lanes, (choice >= shares.lanes) & (choice < shares.lanes + shares.region)
    side = _side_of_line(random.fold_in(keys, 1), scene)
    apart = PerType(agents=behind.agents | (region & side.agents), lanes=behind.lanes | (region & side.lanes))
    some = _some_agents(random.fold_in(keys, 2), scene.agent_mask)
    known = PerType(agents=apart.agents | (all_lanes & some), lanes=apart.lanes | (all_lanes & scene.lane_mask))
    return _known_first(scene, known, apart)


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


def _some_agents(keys: Array, mask: Bool[AnyArray, "b n"]) -> Bool[Array, "b n"]:
    """In half of the scenes none, in the others the ego and a random share of the rest."""
    shares = random.uniform(random.fold_in(keys, 0), mask.shape[:1])[:, None]
    drawn = random.uniform(random.fold_in(keys, 1), mask.shape) < 2 * shares - 1
    drawn = drawn.at[:, 0].set(True)
    return drawn & (shares > 0.5) & mask


def _side_of_line(keys: Array, scene: Scene) -> PerType:
    """Elements left of a line through a random place in a random direction, and the ego."""
    lanes, agents = jnp.asarray(scene.lanes), jnp.asarray(scene.agents)
    draws = random.uniform(keys, (len(lanes), 3))
    angle, place = 2 * np.pi * draws[:, 0], (draws[:, 1:] - 0.5) * TILE_SIZE
    normal = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)

    def side(points: Array) -> Array:
        return ((points - place[:, None]) * normal[:, None]).sum(-1) > 0

    is_left = PerType(agents=side(agents[..., :2]), lanes=side(lanes[:, :, lanes.shape[-2] // 2 - 1, :2]))
    return PerType(agents=is_left.agents.at[:, 0].set(True) & scene.agent_mask, lanes=is_left.lanes & scene.lane_mask)
