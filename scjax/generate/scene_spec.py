"""What a condition holds fixed of one scene, in the terms of a model: the last place that knows of conditions.

Conditions become specs in three stages: prompts become attributes (``readings``), texts and pictures become streams of
tokens (``encode``), and counts, domain and known elements are brought into the terms of the model.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from scjax.data.token_order import sort_tokens
from scjax.encoders.dashcam_weights import takes_standard_views
from scjax.generate.components import Model
from scjax.generate.conditions import Condition, Stream
from scjax.generate.encode import encode_conditions
from scjax.generate.readings import read_prompts
from scjax.generate.seen_picture import SeenPicture
from scjax.scene import Crop, Scene, permute, unpadded

AGENT_COUNTS = ("vehicles", "pedestrians", "cyclists")
"""Attributes that give the number of agents."""


@dataclasses.dataclass(frozen=True)
class KnownElements:
    """Elements of a scene that stay as they are.

    Attributes:
      scene: unpadded, in the user's order.
    """

    scene: Scene

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of agents and lanes; they are the first of a scene."""
        return len(self.scene.agent_mask), len(self.scene.lane_mask)

    @property
    def tokens(self) -> Scene:
        """The scene in the order of the networks' tokens."""
        return self._sorted[0]

    @property
    def agent_order(self) -> Int[np.ndarray, " agents"]:
        """The user's index of every token of an agent."""
        return self._sorted[1]

    @property
    def lane_order(self) -> Int[np.ndarray, " lanes"]:
        """The user's index of every token of a lane."""
        return self._sorted[2]

    @functools.cached_property
    def _sorted(self) -> tuple[Scene, np.ndarray, np.ndarray]:
        return sort_tokens(self.scene)

    def restore(self, scene: Scene) -> Scene:
        """A sampled scene without padding, whose known elements are exactly the user's, in the user's order."""
        agents, lanes = (
            np.concatenate([np.argsort(order), np.arange(len(order), len(mask))])
            for order, mask in ((self.agent_order, scene.agent_mask), (self.lane_order, scene.lane_mask))
        )
        scene = permute(scene, agents, lanes)
        fields = scene.to_dict()
        num_agents, num_lanes = self.counts
        for name in ("agents", "agent_types", "agent_known"):
            fields[name] = np.concatenate([getattr(self.scene, name), fields[name][num_agents:]])
        for name in ("lanes", "lane_known", "signals"):
            fields[name] = np.concatenate([getattr(self.scene, name), fields[name][num_lanes:]])
        links = fields["links"].copy()
        links[:num_lanes, :num_lanes] = self.scene.links
        return scene.replace(**{**fields, "links": links})


@dataclasses.dataclass(frozen=True, kw_only=True)
class SceneSpec:
    """What is fixed of a scene to sample, as a model can meet it; the rest is drawn.

    Attributes:
      crop: the window.
      domain: its index; None: open.
      num_agents, num_lanes: totals, with the ego and known elements; None: open.
      known: elements that stay; None: none.
      attributes, negative_attributes: what the scene shall show, and what guidance leads away from.
      streams: tokens of the condition, by name.
      picture: what its picture shows, where that holds; None: nothing.
      warnings: sentences about parts of its prompt that will not come true.
      likely: attributes that its prompt may ask for too (``readings``).
    """

    crop: Crop
    domain: int | None
    num_agents: int | None
    num_lanes: int | None
    known: KnownElements | None
    attributes: Mapping[str, Any]
    negative_attributes: Mapping[str, Any]
    streams: Mapping[str, Stream]
    picture: SeenPicture | None
    warnings: Sequence[str] = ()
    likely: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def fixes_agents(self) -> bool:
        """Whether the number of agents is the user's, or follows from attributes."""
        return self.num_agents is not None or any(name in self.attributes for name in AGENT_COUNTS)

    @property
    def known_counts(self) -> tuple[int, int]:
        """Numbers of known agents and known lanes."""
        return (0, 0) if self.known is None else self.known.counts

    def check_counts(self, max_agents: int, max_lanes: int) -> None:
        """Whether the numbers hold the known elements, and a model may have so many.

        Raises:
          ValueError: names the number and its range.
        """
        num_known = self.known_counts
        for name, value, low, high in (
            ("num_agents", self.num_agents, num_known[0], max_agents),
            ("num_lanes", self.num_lanes, num_known[1], max_lanes),
        ):
            if value is not None and not low <= value <= high:
                raise ValueError(
                    f"Condition.{name} is {value}, but must lie in {max(low, 1)}..{high} "
                    "(known elements .. the model's maximum)"
                )


def specify_scenes(conditions: Sequence[Condition | SceneSpec], model: Model) -> list[SceneSpec]:
    """What each condition fixes of its scene, with what its prompt asks for; specs stay as they are.

    Raises:
      ValueError: something that the model cannot read or meet; or as ``read_prompts`` and ``encode_conditions``.
    """
    specs = {i: one for i, one in enumerate(conditions) if isinstance(one, SceneSpec)}
    conditions, warnings, likely = read_prompts([one for one in conditions if isinstance(one, Condition)], model)
    streams = encode_conditions(conditions, model)
    others = map(specify_scene, conditions, streams, itertools.repeat(model), warnings, likely)
    return [specs[i] if i in specs else next(others) for i in range(len(specs) + len(conditions))]


def specify_scene(
    condition: Condition,
    streams: Mapping[str, Stream],
    model: Model,
    warnings: Sequence[str] = (),
    likely: Mapping[str, Any] | None = None,
) -> SceneSpec:
    """What a condition fixes of its scene, after its prompt was read.

    Args:
      streams: of the condition (``encode_conditions``).
      warnings: about its prompt.
      likely: attributes that its prompt may ask for too; None: none.

    Raises:
      ValueError: counts or a domain that the model cannot meet.
    """
    known = None
    if condition.known is not None:
        known = KnownElements(model.codec.select(unpadded(condition.known.to_numpy())))
    spec = SceneSpec(
        crop=condition.crop,
        domain=_domain_index(condition.domain, model.domains),
        num_agents=condition.num_agents,
        num_lanes=condition.num_lanes,
        known=known,
        attributes=condition.attributes,
        negative_attributes=condition.negative_attributes,
        streams=streams,
        picture=_seen_picture(streams, model) if condition.hold_seen and known is None else None,
        warnings=warnings,
        likely=likely or {},
    )
    spec.check_counts(model.denoiser.config.max_agents, model.denoiser.config.max_lanes)
    return spec


def _seen_picture(streams: Mapping[str, Stream], model: Model) -> SeenPicture | None:
    """What is seen by the network whose tokens say where agents are, if the model's pictures are read by it."""
    if "image" not in streams or model.views is None or not model.denoiser.config.agent_kinds:
        return None
    if not takes_standard_views(model.image_encoder):
        return None
    image = streams["image"]
    return SeenPicture(np.asarray(image.grid()), None if image.views is None else np.asarray(image.views))


def _domain_index(domain: str | int | None, names: tuple[str, ...]) -> int | None:
    if isinstance(domain, str):
        if domain not in names:
            raise ValueError(f"Condition.domain {domain!r} is unknown: this model has {', '.join(names)}")
        return names.index(domain)
    if domain is not None and not 0 <= domain < len(names):
        raise ValueError(f"Condition.domain {domain} is outside 0..{len(names) - 1} ({names})")
    return domain
