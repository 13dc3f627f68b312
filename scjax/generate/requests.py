"""One scene to sample: its key, condition streams, counts, domain and known elements."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Int

from scjax.data.token_order import sort_tokens
from scjax.generate.conditions import Condition, Stream
from scjax.generate.counts import CountTables
from scjax.generate.model import Model
from scjax.generate.outline_draw import draw_outline, view_row
from scjax.generate.seen_agents import held_agents, sees_agents
from scjax.generate.seen_picture import SeenPicture
from scjax.models.counts.prior import draw_counts
from scjax.scene import Crop, Scene, permute, unpadded
from scjax.scene.per_type import PerType

_COUNTS_KEY = 0xC0  # folded into a scene's key for the draw of its counts
_AGENT_COUNTS = ("vehicles", "pedestrians", "cyclists")
_CANDIDATES_KEY = 0xBE  # folded into a scene's key for its further candidates


@dataclasses.dataclass(frozen=True)
class KnownElements:
    """Elements of a scene that stay as they are.

    Attributes:
      scene: unpadded, in the user's order.
      tokens: the same scene in the order of the networks' tokens.
      agent_order, lane_order: the user's index of every token.
    """

    scene: Scene
    tokens: Scene
    agent_order: Int[np.ndarray, " agents"]
    lane_order: Int[np.ndarray, " lanes"]


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
        return (0, 0) if self.known is None else (len(self.known.agent_order), len(self.known.lane_order))

    def candidates(self, number: int) -> list[Request]:
        """``number`` requests that differ in their latents alone; the first is this request."""
        key = jax.random.fold_in(self.key, _CANDIDATES_KEY)
        others = [dataclasses.replace(self, key=jax.random.fold_in(key, k)) for k in range(1, number)]
        return [self, *others]

    def finish(self, scene: Scene) -> Scene:
        """A sampled scene without padding, with the known elements, and in agreement with what is seen."""
        scene = self.restore_known(scene)
        return scene if self.picture is None else self.picture.fit(scene, self.known_counts[0], self.fixed_number)

    def restore_known(self, scene: Scene) -> Scene:
        """A sampled scene without padding, whose known elements are exactly the user's, in the user's order."""
        scene = unpadded(scene)
        if self.known is None:
            return scene
        agents, lanes = (
            np.concatenate([np.argsort(order), np.arange(len(order), total)])
            for order, total in ((self.known.agent_order, self.num_agents), (self.known.lane_order, self.num_lanes))
        )
        scene, known = permute(scene, agents, lanes), self.known.scene
        num_agents, num_lanes = self.known_counts
        fields = scene.to_dict()
        for name in ("agents", "agent_types", "agent_known"):
            fields[name] = np.concatenate([getattr(known, name), fields[name][num_agents:]])
        for name in ("lanes", "lane_known", "signals"):
            fields[name] = np.concatenate([getattr(known, name), fields[name][num_lanes:]])
        links = fields["links"].copy()
        links[:num_lanes, :num_lanes] = known.links
        return scene.replace(**{**fields, "links": links})


def draw_request(
    key: Array, condition: Condition, streams: Mapping[str, Stream], model: Model, tables: CountTables
) -> Request:
    """Draws the domain and the counts that a condition leaves open, on the host and from the scene's own key.

    Raises:
      ValueError: counts or a domain that the model cannot meet.
    """
    known = None if condition.known is None else model.codec.select(unpadded(condition.known.to_numpy()))
    num_known = (0, 0) if known is None else (len(known.agent_mask), len(known.lane_mask))
    _check_counts(condition, num_known, model)
    domain = _domain_index(condition, model)
    most, reads = model.denoiser.config.max_agents, tables.read_attributes
    seed = np.asarray(jax.random.key_data(jax.random.fold_in(key, _COUNTS_KEY)))
    rng = np.random.default_rng(seed.astype(np.uint32))
    view, picture = view_row(rng, condition, streams.get("image"), model), None
    if view is not None and condition.hold_seen and sees_agents(model):
        known = model.codec.select(held_agents(condition, streams["image"], view, domain, model))
        num_known = len(known.agent_mask), 0
        picture = SeenPicture.of_cells(np.asarray(streams["image"].grid()))
    table = tables(streams.get("text"), condition.attributes, domain, condition.crop)
    num_agents = condition.num_agents if reads else _num_agents(condition, num_known[0], most)
    elements = None if known is None else KnownElements(known, *sort_tokens(known))
    outline = draw_outline(rng, condition, domain, None if elements is None else elements.tokens, model, view)
    num_lanes, kinds = condition.num_lanes, None
    if outline is not None:
        kinds = PerType(agents=outline.agents, lanes=outline.lanes)
        domain, num_agents = outline.domain, len(outline.agents)
        num_lanes = num_lanes if outline.num_lanes is None else outline.num_lanes
    domain, num_lanes, num_agents = draw_counts(
        rng,
        table,
        condition.crop,
        domain=domain,
        num_lanes=num_lanes,
        num_agents=num_agents,
        least_lanes=num_known[1],
        least_agents=min(max(num_known[0], _least_agents(condition) if reads else 0), most),
    )
    return Request(
        key=key,
        streams=streams,
        crop=condition.crop,
        domain=domain,
        num_agents=num_agents,
        num_lanes=num_lanes,
        known=elements,
        kinds=kinds,
        attributes=condition.attributes,
        negative_attributes=condition.negative_attributes,
        picture=picture,
        fixed_number=condition.num_agents is not None or any(name in condition.attributes for name in _AGENT_COUNTS),
    )


def draw_candidates(
    key: Array, condition: Condition, streams: Mapping[str, Stream], model: Model, tables: CountTables, number: int
) -> list[Request]:
    """``number`` requests for one scene, of which the first is that of ``draw_request``.

    The others have outlines of their own, with other lanes and agents, where outlines are drawn by a request.
    Otherwise they differ in their latents alone.
    """
    first = draw_request(key, condition, streams, model, tables)
    is_free = condition.known is None and first.picture is None and "image" not in streams
    if first.kinds is None or model.outlines is None or not is_free or not condition.attributes:
        return first.candidates(number)
    keys = [one.key for one in first.candidates(number)[1:]]
    return [first, *(draw_request(one, condition, streams, model, tables) for one in keys)]


def _num_agents(condition: Condition, num_known: int, most: int) -> int | None:
    """Agents as given, else by the attributes if these give the vehicles, else None.

    It is for models without a network that predicts them from attributes. The number is the middle of each range, or
    its lower end where the upper one is open.
    """
    if condition.num_agents is not None or "vehicles" not in condition.attributes:
        return condition.num_agents
    ranges = [condition.attributes[name] for name in _AGENT_COUNTS if name in condition.attributes]
    total = 1 + sum(int(low if high is None else (low + high) // 2) for low, high in ranges)
    return min(max(total, num_known, 1), most)


def _least_agents(condition: Condition) -> int:
    """Agents that the attributes request at least, the ego included."""
    return 1 + sum(int(condition.attributes.get(name, (0, None))[0]) for name in (*_AGENT_COUNTS, "static"))


def _check_counts(condition: Condition, num_known: tuple[int, int], model: Model) -> None:
    config = model.denoiser.config
    for name, value, low, high in (
        ("num_agents", condition.num_agents, num_known[0], config.max_agents),
        ("num_lanes", condition.num_lanes, num_known[1], config.max_lanes),
    ):
        if value is not None and not low <= value <= high:
            raise ValueError(
                f"Condition.{name} is {value}, but must lie in {max(low, 1)}..{high} "
                "(known elements .. the model's maximum)"
            )


def _domain_index(condition: Condition, model: Model) -> int | None:
    domain = condition.domain
    if isinstance(domain, str):
        if domain not in model.domains:
            raise ValueError(f"Condition.domain {domain!r} is unknown: this model has {', '.join(model.domains)}")
        return model.domains.index(domain)
    if domain is not None and not 0 <= domain < len(model.domains):
        raise ValueError(f"Condition.domain {domain} is outside 0..{len(model.domains) - 1} ({model.domains})")
    return domain
