"""A trained model: networks by name, with the codec, statistics and defaults that sampling needs.

A model folder holds ``model.json`` (the index: configs and statistics), safetensors files with the parameters, and the
token features of prompts that need no text encoder.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from scjax.diffusion.defaults import DEFAULT_TEMPERATURE
from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.generate.model_format import FORMAT, codec_from_json, config_from_json, config_to_json, upgrade
from scjax.generate.prompt_cache import load_prompts, write_prompts
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.codec import SceneCodec
from scjax.models.counts.predictor import CountPredictorConfig
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.latents import LatentStatistics
from scjax.nn.functional import Params, flatten, unflatten
from scjax.nn.safetensors import read_arrays, write_arrays
from scjax.nn.sharding import replicated, scene_mesh
from scjax.scene.per_type import PerType

DEFAULT_MODEL = Path(__file__).parents[1] / "pretrained"
"""Folder of the model that ships with the package."""

COMPONENTS: dict[str, type] = {
    "autoencoder": AutoencoderConfig,
    "denoiser": DenoiserConfig,
    "count_predictor": CountPredictorConfig,
}
"""Name of a network in ``Model.components`` -> type of its config. A new network is one more line."""

INDEX, PROMPTS = "model.json", "prompts.safetensors"
_WEIGHTS, _COUNTS = "weights.safetensors", "counts"

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
      text_encoder: name of the encoder whose token features the denoiser was trained on; "" for none.
      prompts: text -> token features [tokens, width] of prompts that need no encoder.
      temperature: default scale of the sampler's noise, per type.
      energy_guidance: default energy guidance of the sampler, or None.
      notes: free JSON: training data, steps, license.
    """

    components: Mapping[str, Component[Any]]
    codec: SceneCodec
    latents: LatentStatistics
    domains: tuple[str, ...]
    counts: np.ndarray | None = None
    text_encoder: str = ""
    prompts: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    temperature: PerType = DEFAULT_TEMPERATURE
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


def save_model(model: Model, folder: str | Path, *, dtype: str | None = None, largest: float | None = None) -> Path:
    """Writes a model folder and returns its path. An existing folder is replaced at the end, as a whole.

    Args:
      dtype, largest: precision and size [MB] of the weight files, as in ``scjax.nn.safetensors.write_arrays``.
    """
    folder = Path(folder)
    index = {
        "format": FORMAT,
        "components": {name: config_to_json(component.config) for name, component in model.components.items()},
        "codec": dataclasses.asdict(model.codec),
        "latents": dataclasses.asdict(model.latents),
        "domains": list(model.domains),
        "text_encoder": model.text_encoder,
        "temperature": dataclasses.asdict(model.temperature),
        "energy_guidance": dataclasses.asdict(model.energy_guidance) if model.energy_guidance else None,
        "notes": model.notes,
    }
    params = {name: component.params for name, component in model.components.items()}
    arrays = {".".join(map(str, path)): np.asarray(leaf) for path, leaf in flatten(params).items()}
    if model.counts is not None:
        arrays[_COUNTS] = np.asarray(model.counts)
    temporary = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}")
    temporary.mkdir(parents=True)
    try:
        index["files"] = write_arrays(arrays, temporary, dtype=dtype, largest=largest, exact=(_COUNTS,))
        (temporary / INDEX).write_text(json.dumps(index, indent=1))
        if model.prompts:
            write_prompts(model.prompts, model.text_encoder, temporary / PROMPTS)
        retired = folder.with_name(f"{temporary.name}.old")
        if folder.exists():
            folder.rename(retired)
        temporary.rename(folder)
        shutil.rmtree(retired, ignore_errors=True)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def load_model(path: str | Path | None = None) -> Model:
    """Reads a model folder that ``save_model``, training or ``python -m scjax.convert`` wrote.

    Args:
      path: the folder; None: the model that ships with scjax, trained on its synthetic world alone, read once.

    Raises:
      ValueError: the folder is missing, incomplete, damaged (by the hashes of its files), or of a newer format.
    """
    return _default_model() if path is None else _read(Path(path))


@functools.cache
def _default_model() -> Model:
    return _read(DEFAULT_MODEL)


def _read(folder: Path) -> Model:
    if not (folder / INDEX).is_file():
        raise ValueError(f"{folder} is no model folder: it has no {INDEX}. Train one with python -m experiments.train")
    try:
        index = json.loads((folder / INDEX).read_text())
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(f"{folder} is damaged ({error}): copy or export the model again") from error
    if index.get("format", 0) > FORMAT:
        raise ValueError(f"{folder} has model format {index['format']}, this code reads {FORMAT}: update scjax")
    index, arrays = upgrade(index, read_arrays(folder, index.get("files", {_WEIGHTS: ""})))
    counts = arrays.pop(_COUNTS, None)
    params = unflatten({_path(name): array for name, array in arrays.items()})
    text_encoder = index.get("text_encoder", "")
    return Model(
        components={
            name: Component(config_from_json(COMPONENTS[name], fields), params[name])
            for name, fields in index["components"].items()
        },
        codec=codec_from_json(index["codec"]),
        latents=LatentStatistics(**index["latents"]),
        domains=tuple(index["domains"]),
        counts=counts,
        text_encoder=text_encoder,
        prompts=load_prompts(folder / PROMPTS, text_encoder),
        temperature=PerType(**index["temperature"]) if "temperature" in index else DEFAULT_TEMPERATURE,
        energy_guidance=EnergyGuidance.from_dict(index["energy_guidance"]) if index.get("energy_guidance") else None,
        notes=index["notes"],
    )


def _path(name: str) -> tuple[str | int, ...]:
    """Dotted array name -> path in a parameter tree; positions in lists of modules are numbers."""
    return tuple(int(part) if part.isdigit() else part for part in name.split("."))
