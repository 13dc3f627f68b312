"""The index of a model folder as JSON: configs to and from plain values, and folders of older formats."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec import Struct

from scjax.generate.model_checks import check_network_config
from scjax.models.codec import SceneCodec
from scjax.scene import AgentType, Link
from scjax.scene.per_type import PerType

FORMAT = 2

_COMPONENTS_OF_FORMAT_1 = ("autoencoder", "denoiser", "count_predictor")

# Format 1 -> 2: networks move into "components", and names change; every array stays bit for bit what it was.
_PARTS = {"representation": "codec", "counter": "count_predictor", "steering": "energy_guidance"}
_DENOISER = {
    "control": "cross_attention",
    "layouts": "crops",
    "given_embedding": "known_embedding",
    "waves": "fourier_features",
    "hints": "relative_geometry",
}
_ENERGY_GUIDANCE = {
    "rounds": "gradient_steps",
    "below": "max_sigma",
    "agents": "agent_step_size",
    "lanes": "lane_step_size",
}
_ARRAYS = {
    "counter": {"given_lanes": "known_lanes"},
    "denoiser": {
        "lane_waves": "lane_fourier",
        "agent_waves": "agent_fourier",
        "lane_given": "lane_known",
        "agent_given": "agent_known",
        "hints": "relative_geometry",
        "anchors": "position_heads",
    },
}


def config_to_json(config: Any) -> dict[str, Any]:
    """The fields of a config dataclass as plain values; its own ``to_json`` where it has one."""
    return config.to_json() if hasattr(config, "to_json") else dataclasses.asdict(config)


def config_from_json(config_type: type, fields: dict[str, Any]) -> Any:
    """Inverse of ``config_to_json``."""
    return config_type.from_json(fields) if hasattr(config_type, "from_json") else config_type(**fields)


def read_config(name: str, config_type: type, fields: dict[str, Any]) -> Any:
    """``config_from_json`` of a file.

    Raises:
      ValueError: names the component and what is wrong in it.
    """
    config = read_part(name, lambda content: config_from_json(config_type, content), fields)
    check_network_config(name, config)
    return config


def read_part(name: str, read: Callable[[dict[str, Any]], Any], fields: dict[str, Any]) -> Any:
    """What ``read`` makes of the fields of a file; ValueError names the part where it cannot."""
    try:
        return read(fields)
    except KeyError as error:
        raise ValueError(f"{name} lacks the field {error}") from error
    except (ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
        raise ValueError(f"{name}: {error}") from error


def index_hash(index: dict[str, Any]) -> str:
    """A hash of the index without itself: equal only if nothing was edited since the model was checked."""
    content = {name: value for name, value in index.items() if name != "checked"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


class PerTypeFields(Struct):
    """Two numbers, one for agents and one for lanes."""

    agents: float
    lanes: float

    def to_per_type(self) -> PerType:
        """The pair as the networks take it."""
        return PerType(agents=self.agents, lanes=self.lanes)


class LatentFields(Struct):
    """Means and standard deviations of latents."""

    mean: PerTypeFields
    std: PerTypeFields


class ModelIndex(Struct):
    """The content of model.json in ``FORMAT``."""

    components: dict[str, dict[str, Any]]
    codec: dict[str, Any]
    latents: LatentFields
    domains: list[str]
    notes: dict[str, Any]
    text_encoder: str = ""
    image_encoder: str = ""
    image_keeps_aspect: bool = False
    estimates_depth: bool = False
    reads_prompts: bool = False
    temperature: PerTypeFields | None = None
    num_steps: int | None = None
    guidance: float | None = None
    energy_guidance: dict[str, Any] | None = None
    prompts: str = ""
    outline_values: dict[str, list[Any]] = {}


def codec_from_json(fields: dict[str, Any]) -> SceneCodec:
    """A codec from its fields, which JSON turned into lists and numbers."""
    return SceneCodec(
        **{
            **fields,
            "agent_types": tuple(AgentType(value) for value in fields["agent_types"]),
            "columns": tuple(fields["columns"]),
            "links": tuple(Link(value) for value in fields["links"]),
            "agent_z": tuple(fields["agent_z"]),
            "lane_z": tuple(fields["lane_z"]),
            "speed": tuple(fields["speed"]),
            "sizes": tuple(tuple(tuple(bounds) for bounds in row) for row in fields["sizes"]),
        }
    )


def upgrade(index: dict[str, Any], arrays: dict[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The contents of a model folder of any older format, in the names of ``FORMAT``.

    Args:
      index: the content of ``model.json``.
      arrays: dotted parameter path -> array.

    Raises:
      ValueError: a part has another form than its format says.
    """
    if index.get("format", 0) >= FORMAT:
        return index, arrays
    if "components" in index:
        raise ValueError(f"format is {index.get('format')!r:.80}, but a model with components has {FORMAT}")
    index = {_PARTS.get(name, name): value for name, value in index.items()}
    for name in (*_COMPONENTS_OF_FORMAT_1, "energy_guidance"):
        if not isinstance(index.get(name), dict | None):
            raise ValueError(f"{name} must be an object or null, not {index[name]!r:.80}")
    if index.get("denoiser"):
        index["denoiser"] = {_DENOISER.get(name, name): value for name, value in index["denoiser"].items()}
    if index.get("energy_guidance"):
        fields = index["energy_guidance"].items()
        index["energy_guidance"] = {_ENERGY_GUIDANCE.get(name, name): value for name, value in fields}
    components = {name: index.pop(name, None) for name in _COMPONENTS_OF_FORMAT_1}
    index["components"] = {name: fields for name, fields in components.items() if fields}
    return {**index, "format": FORMAT}, {_upgrade_path(path): array for path, array in arrays.items()}


def _upgrade_path(path: str) -> str:
    part, *rest = path.split(".")
    if rest:
        rest[0] = _ARRAYS.get(part, {}).get(rest[0], rest[0])
    return ".".join([_PARTS.get(part, part), *rest])
