"""One scene to sample: its key, condition streams, counts, domain and known elements."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from scjax.generate.conditions import Stream
from scjax.generate.counts import CountTables
from scjax.generate.model import Model
from scjax.generate.outline_draw import draw_outline, view_row
from scjax.generate.scene_spec import KnownElements, SceneSpec
from scjax.generate.seen_agents import held_agents, sees_agents
from scjax.generate.seen_picture import SeenPicture
from scjax.models.counts.prior import draw_counts
from scjax.scene import Crop, Scene, unpadded
from scjax.scene.per_type import PerType

_COUNTS_KEY = 0xC0  # folded into a scene's key for the draw of its counts
_AGENT_COUNTS = ("vehicles", "pedestrians", "cyclists")
_CANDIDATES_KEY = 0xBE  # folded into a scene's key for its further candidates


@dataclasses.dataclass(frozen=True)
class Request:
    """One scene to sample; everything but its latents is decided.

    Attributes:
      picture: what a picture shows, where the known agents are those that it shows; None: nothing is seen.
      fixed_number: whether the number of agents is the user's.
    """

    key: Array
    streams: Mapping[str, Stream]
    crop: Crop
    domain: int
    num_agents: int
    num_lanes: int
    known: KnownElements | None
    kinds: PerType | None = None
    attributes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    negative_attributes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    picture: SeenPicture | None = None
    fixed_number: bool = False

    @property
    def known_counts(self) -> tuple[int, int]:
        """Numbers of known agents and known lanes; they are the first of a scene."""
        return (0, 0) if self.known is None else self.known.counts

    def candidates(self, number: int) -> list[Request]:
        """``number`` requests that differ in their latents alone; the first is this request."""
        key = jax.random.fold_in(self.key, _CANDIDATES_KEY)
        others = [dataclasses.replace(self, key=jax.random.fold_in(key, k)) for k in range(1, number)]
        return [self, *others]

    def finish(self, scene: Scene) -> Scene:
        """A sampled scene without padding, with the known elements, and in agreement with what is seen."""
        scene = unpadded(scene) if self.known is None else self.known.restore(unpadded(scene))
        return scene if self.picture is None else self.picture.fit(scene, self.known_counts[0], self.fixed_number)


def draw_request(key: Array, spec: SceneSpec, model: Model, tables: CountTables) -> Request:
    """Draws the domain, the counts and the outline that are open, on the host and from the scene's own key.

    Raises:
      ValueError: counts that the model cannot meet.
    """
    seed = np.asarray(jax.random.key_data(jax.random.fold_in(key, _COUNTS_KEY)))
    rng = np.random.default_rng(seed.astype(np.uint32))
    view, picture = view_row(rng, spec, model), None
    if view is not None and spec.hold_seen and sees_agents(model):
        image = spec.streams["image"]
        seen = held_agents(np.asarray(image.tokens), view, spec.num_agents, spec.domain, model)
        spec = dataclasses.replace(spec, known=KnownElements(model.codec.select(seen)))
        picture = SeenPicture.of_cells(np.asarray(image.grid()))
    domain, num_lanes, kinds = spec.domain, spec.num_lanes, None
    most, reads, num_known = model.denoiser.config.max_agents, tables.read_attributes, spec.known_counts
    num_agents = spec.num_agents
    if num_agents is None and not reads:
        num_agents = _num_agents(spec.attributes, num_known[0], most)
    outline = draw_outline(rng, spec, model, view)
    if outline is not None:
        kinds = PerType(agents=outline.agents, lanes=outline.lanes)
        domain, num_agents = outline.domain, len(outline.agents)
        num_lanes = num_lanes if outline.num_lanes is None else outline.num_lanes
    domain, num_lanes, num_agents = draw_counts(
        rng,
        tables(spec.streams.get("text"), spec.attributes, spec.domain, spec.crop),
        spec.crop,
        domain=domain,
        num_lanes=num_lanes,
        num_agents=num_agents,
        least_lanes=num_known[1],
        least_agents=min(max(num_known[0], _least_agents(spec.attributes) if reads else 0), most),
    )
    return Request(
        key=key,
        streams=spec.streams,
        crop=spec.crop,
        domain=domain,
        num_agents=num_agents,
        num_lanes=num_lanes,
        known=spec.known,
        kinds=kinds,
        attributes=spec.attributes,
        negative_attributes=spec.negative_attributes,
        picture=picture,
        fixed_number=spec.num_agents is not None or any(name in spec.attributes for name in _AGENT_COUNTS),
    )


def draw_candidates(key: Array, spec: SceneSpec, model: Model, tables: CountTables, number: int) -> list[Request]:
    """``number`` requests for one scene, of which the first is that of ``draw_request``.

    The others have outlines of their own, with other lanes and agents, where outlines are drawn by a request.
    Otherwise they differ in their latents alone.
    """
    first = draw_request(key, spec, model, tables)
    is_free = first.known is None and "image" not in spec.streams
    if first.kinds is None or model.outlines is None or not is_free or not spec.attributes:
        return first.candidates(number)
    keys = [one.key for one in first.candidates(number)[1:]]
    return [first, *(draw_request(one, spec, model, tables) for one in keys)]


def _num_agents(attributes: Mapping[str, Any], num_known: int, most: int) -> int | None:
    """Agents by the attributes if these give the vehicles, else None.

    It is for models without a network that predicts them from attributes. The number is the middle of each range, or
    its lower end where the upper one is open.
    """
    if "vehicles" not in attributes:
        return None
    ranges = [attributes[name] for name in _AGENT_COUNTS if name in attributes]
    total = 1 + sum(int(low if high is None else (low + high) // 2) for low, high in ranges)
    return min(max(total, num_known, 1), most)


def _least_agents(attributes: Mapping[str, Any]) -> int:
    """Agents that the attributes request at least, the ego included."""
    return 1 + sum(int(attributes.get(name, (0, None))[0]) for name in (*_AGENT_COUNTS, "static"))
