"""One scene to sample: its key, what is fixed, and the domain, counts and outline that are drawn."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
from jaxtyping import Array, Bool

from scjax.generate.counts import CountTables
from scjax.generate.lane_places import keep_to_lanes
from scjax.generate.model import Model
from scjax.generate.outline_draw import draw_outline
from scjax.generate.scene_spec import SceneSpec
from scjax.generate.view_draw import draw_view, hold_seen_agents
from scjax.scene import Scene, unpadded
from scjax.scene.per_type import PerType

_COUNTS_KEY = 0xC0  # folded into a scene's key for the draw of its counts
_CANDIDATES_KEY = 0xBE  # folded into a scene's key for its further candidates


@dataclasses.dataclass(frozen=True)
class Request:
    """One scene to sample; everything but its latents is decided.

    Attributes:
      spec: what is fixed; its known elements are those that the user gives or that a picture shows.
      domain: its index.
      num_agents, num_lanes: totals.
      kinds: of all tokens, for networks that read them; None: the network decides.
      along: agents that are to go along a lane (``Outline``); None: they stay where they are sampled.
    """

    key: Array
    spec: SceneSpec
    domain: int
    num_agents: int
    num_lanes: int
    kinds: PerType | None = None
    along: Bool[np.ndarray, " agents"] | None = None

    def candidates(self, number: int) -> list[Request]:
        """``number`` requests that differ in their latents alone; the first is this request."""
        key = jax.random.fold_in(self.key, _CANDIDATES_KEY)
        others = [dataclasses.replace(self, key=jax.random.fold_in(key, k)) for k in range(1, number)]
        return [self, *others]

    def finish(self, scene: Scene) -> Scene:
        """A sampled scene without padding, with the known elements, and in agreement with what is seen."""
        scene, spec = unpadded(scene), self.spec
        if spec.known is not None:
            scene = spec.known.restore(scene)
        if self.along is not None:
            scene = keep_to_lanes(scene, self.along)
        if spec.picture is not None:
            scene = spec.picture.fit(scene, spec.known_counts[0], spec.fixes_agents)
        return scene


def draw_request(key: Array, spec: SceneSpec, model: Model, tables: CountTables) -> Request:
    """Draws the domain, the counts and the outline that are open, on the host and from the scene's own key.

    Raises:
      ValueError: counts that the model cannot meet.
    """
    seed = np.asarray(jax.random.key_data(jax.random.fold_in(key, _COUNTS_KEY)))
    rng = np.random.default_rng(seed.astype(np.uint32))
    view = draw_view(rng, spec, model)
    if view is not None:
        spec = hold_seen_agents(spec, view, model)
    outline = draw_outline(rng, spec, model, view)
    domain, num_lanes, num_agents = tables.draw(rng, spec, outline)
    kinds = None if outline is None else PerType(agents=outline.agents, lanes=outline.lanes)
    return Request(key, spec, domain, num_agents, num_lanes, kinds, None if outline is None else outline.along)


def draw_candidates(key: Array, spec: SceneSpec, model: Model, tables: CountTables, number: int) -> list[Request]:
    """``number`` requests for one scene, of which the first is that of ``draw_request``.

    The others have outlines of their own, with other lanes and agents, where outlines are drawn by a request.
    Otherwise they differ in their latents alone.
    """
    first = draw_request(key, spec, model, tables)
    is_free = spec.known is None and "image" not in spec.streams
    if first.kinds is None or model.outlines is None or not is_free or not spec.attributes:
        return first.candidates(number)
    keys = [one.key for one in first.candidates(number)[1:]]
    return [first, *(draw_request(one, spec, model, tables) for one in keys)]
