"""A trained model: networks by name, with the codec, statistics and defaults that sampling needs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from scjax.diffusion.defaults import DEFAULT_TEMPERATURE
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.generate.outlines import Outlines
from scjax.generate.view_outlines import ViewOutlines
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import autoencoder
from scjax.models.codec import SceneCodec
from scjax.models.counts.predictor import CountPredictorConfig, count_predictor
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.model import denoiser
from scjax.models.latents import LatentStatistics
from scjax.nn.functional import Functional, Params
from scjax.nn.sharding import replicated, scene_mesh
from scjax.scene.per_type import PerType


class ComponentType(NamedTuple):
    """The type of a network's config, and the network for such a config."""

    config: type
    network: Callable[[Any], Functional]


COMPONENTS: dict[str, ComponentType] = {
    "autoencoder": ComponentType(AutoencoderConfig, autoencoder),
    "denoiser": ComponentType(DenoiserConfig, denoiser),
    "count_predictor": ComponentType(CountPredictorConfig, count_predictor),
}
"""Name of a network in ``Model.components`` -> its type. A new network is one more line."""

Config = TypeVar("Config")


@dataclasses.dataclass(frozen=True)
class Component(Generic[Config]):
    """A network of a model: its sizes, and its parameters as a nested dict of arrays."""

    config: Config
    params: Params
    _placed: dict[int, Params] = dataclasses.field(default_factory=dict, init=False, repr=False, compare=False)

    def placed_params(self, scenes: int) -> Params:
        """The parameters on every device over which so many scenes are spread; they are copied there once."""
        devices = scene_mesh(scenes).size
        if devices not in self._placed:
            self._placed[devices] = replicated(self.params, scenes)
        return self._placed[devices]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Model:
    """Everything that sampling needs. Without a denoiser a model only encodes and decodes.

    Attributes:
      components: networks by name, see ``COMPONENTS``.
      codec: types, columns and ranges of the scenes.
      latents: mean and standard deviation of the latents, per type.
      domains: names behind the domain labels.
      counts: [domains, crops, max_lanes + 1, max_agents + 1] probabilities of (N_l, N_o), or None.
      outlines: kinds of lanes and agents in scenes of the training, for networks that read kinds, or None.
      views: outlines of forward windows and how pictures choose among them, or None.
      text_encoder: name of the encoder whose token features the denoiser was trained on; "" for none.
      image_encoder: name of the encoder whose features of pictures the denoiser was trained on; "" for none.
      image_keeps_aspect: whether it was trained on pictures that keep their proportions (``Preprocessing``).
      estimates_depth: whether it was trained on depth that the embedded network estimates (``default_depth``), so that
        this is its depth of pictures where none is given.
      prompts: text -> token features [tokens, width] of prompts that need no encoder.
      reads_prompts: whether prompts become requests for attributes (``generate.readings``), which the network then
        reads, as text or by themselves. Networks that read attributes and no text always need that.
      temperature: default scale of the sampler's noise, per type.
      num_steps: default number of steps of the default sampler; None: the sampler's own.
      guidance: default guidance scale; None: 2 for conditional networks, else 1.
      energy_guidance: default energy guidance of the sampler, or None.
      notes: free JSON: training data, steps, license.
    """

    components: Mapping[str, Component[Any]]
    codec: SceneCodec
    latents: LatentStatistics
    domains: tuple[str, ...]
    counts: np.ndarray | None = None
    outlines: Outlines | None = None
    views: ViewOutlines | None = None
    text_encoder: str = ""
    image_encoder: str = ""
    image_keeps_aspect: bool = False
    estimates_depth: bool = False
    prompts: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    reads_prompts: bool = False
    temperature: PerType = DEFAULT_TEMPERATURE
    num_steps: int | None = None
    guidance: float | None = None
    energy_guidance: EnergyGuidance | None = None
    notes: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self):
        unknown = sorted(self.components.keys() - COMPONENTS.keys())
        if unknown:
            raise ValueError(f"Model.components: {', '.join(unknown)} unknown: choose from {', '.join(COMPONENTS)}")

    @property
    def autoencoder(self) -> Component[AutoencoderConfig]:
        """The network between scenes and latents; ValueError if the model has none."""
        return self._component("autoencoder")

    @property
    def denoiser(self) -> Component[DenoiserConfig]:
        """The diffusion network; ValueError if the model has none."""
        return self._component("denoiser")

    @property
    def count_predictor(self) -> Component[CountPredictorConfig]:
        """The network that predicts lane and agent counts from a prompt; ValueError if the model has none."""
        return self._component("count_predictor")

    def _component(self, name: str) -> Component[Any]:
        if name not in self.components:
            raise ValueError(f"this model has no {name}: train that stage (or convert its checkpoint) first")
        return self.components[name]

    def with_component(self, name: str, config: Any, params: Params) -> Model:
        """The model with a network added or replaced."""
        return dataclasses.replace(self, components={**self.components, name: Component(config, params)})

    def without(self, *names: str) -> Model:
        """The model without some of its networks."""
        rest = {name: component for name, component in self.components.items() if name not in names}
        return dataclasses.replace(self, components=rest)
