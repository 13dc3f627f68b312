"""A trained model as a value: parameters, configs and statistics, in one folder of safetensors and JSON."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scjax.diffusion.energy_guidance import EnergyGuidance
from scjax.diffusion.samplers.loop import DEFAULT_TEMPERATURE
from scjax.generate.model_format import FORMAT, upgrade
from scjax.generate.prompt_cache import load_prompts, write_prompts
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.codec import SceneCodec
from scjax.models.counts.predictor import CountPredictorConfig
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.latents import LatentStatistics
from scjax.nn.cross_attention import from_name, to_config
from scjax.nn.functional import Params, flatten, unflatten
from scjax.nn.safetensors import read_arrays, write_arrays
from scjax.scene import AgentType, Link
from scjax.scene.per_type import PerType

SHIPPED = Path(__file__).parents[1] / "pretrained"
_JSON, _WEIGHTS, PROMPTS = "model.json", "weights.safetensors", "prompts.safetensors"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Model:
    """Everything that sampling needs. Without a denoiser it only encodes and decodes.

    Attributes:
      codec: types, columns and ranges.
      autoencoder, autoencoder_config: parameters (nested dict) and sizes, or None.
      denoiser, denoiser_config: the same, or None.
      latents: mean and standard deviation of the latents of each kind.
      counts: [domains, layouts, max_lanes + 1, max_agents + 1] probabilities of (N_l, N_o), or None.
      domains: names behind the domain labels.
      text_encoder: name of the encoder whose token features the denoiser was trained on; "" for none.
      prompts: features of texts that ship with the model, so that they need no encoder.
      count_predictor, count_predictor_config: network that tells counts from a prompt (``scjax.models.counts.predictor``), or None.
      temperature: scale of the sampler's noise a kind, unless ``sample`` is told another: what the network needs.
      energy_guidance: how the sampler's estimates are led to sound scenes, unless ``sample`` is told; or None.
      notes: free JSON: training data, steps, licence.
    """

    codec: SceneCodec
    latents: LatentStatistics
    domains: tuple[str, ...]
    autoencoder: Params | None = None
    autoencoder_config: AutoencoderConfig | None = None
    denoiser: Params | None = None
    denoiser_config: DenoiserConfig | None = None
    counts: np.ndarray | None = None
    text_encoder: str = ""
    prompts: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    count_predictor: Params | None = None
    count_predictor_config: CountPredictorConfig | None = None
    temperature: PerType = DEFAULT_TEMPERATURE
    energy_guidance: EnergyGuidance | None = None
    notes: dict[str, Any] = dataclasses.field(default_factory=dict)


def save(model: Model, folder: str | Path, *, dtype: str | None = None, largest: float | None = None) -> Path:
    """Writes ``folder`` (replaced as a whole at the end, never half-written) and returns it.

    Args:
      dtype, largest: precision and megabytes of the weight files, as in ``weights.write_arrays``.
    """
    folder = Path(folder)
    description = {
        "format": FORMAT,
        "codec": dataclasses.asdict(model.codec),
        "autoencoder": dataclasses.asdict(model.autoencoder_config) if model.autoencoder_config else None,
        "denoiser": _described(model.denoiser_config) if model.denoiser_config else None,
        "latents": dataclasses.asdict(model.latents),
        "domains": list(model.domains),
        "text_encoder": model.text_encoder,
        "count_predictor": dataclasses.asdict(model.count_predictor_config) if model.count_predictor_config else None,
        "temperature": dataclasses.asdict(model.temperature),
        "energy_guidance": dataclasses.asdict(model.energy_guidance) if model.energy_guidance else None,
        "notes": model.notes,
    }
    networks = {name: getattr(model, name) or {} for name in ("autoencoder", "denoiser", "count_predictor")}
    arrays = {".".join(map(str, path)): np.asarray(leaf) for path, leaf in flatten(networks).items()}
    if model.counts is not None:
        arrays["counts"] = np.asarray(model.counts)
    temporary = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}")
    temporary.mkdir(parents=True)
    try:
        description["files"] = write_arrays(arrays, temporary, dtype=dtype, largest=largest, exact=("counts",))
        (temporary / _JSON).write_text(json.dumps(description, indent=1))
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


def load(path: str | Path | None = None) -> Model:
    """Reads a model folder written by ``save``, by training or by ``python -m scjax.convert``.

    Args:
      path: the folder; None: the model that ships with scjax, trained on its synthetic world alone, read once.

    Raises:
      ValueError: if the folder is missing, incomplete, damaged (by the hashes of its files), or of a newer format.
    """
    return _shipped() if path is None else _read(Path(path))


@functools.cache
def _shipped() -> Model:
    return _read(SHIPPED)


def _read(folder: Path) -> Model:
    if not (folder / _JSON).is_file():
        raise ValueError(f"{folder} is no model folder: it has no {_JSON}. Train one with python -m experiments.train")
    try:
        description = json.loads((folder / _JSON).read_text())
    except (OSError, json.JSONDecodeError) as error:
        raise ValueError(f"{folder} is damaged ({error}): copy or export the model again") from error
    if description.get("format", 0) > FORMAT:
        raise ValueError(f"{folder} has model format {description['format']}, this code reads {FORMAT}: update scjax")
    flat = read_arrays(folder, description.get("files", {_WEIGHTS: ""}))
    description, flat = upgrade(description, flat)
    counts = flat.pop("counts", None)
    paths = {tuple(int(part) if part.isdigit() else part for part in name.split(".")): a for name, a in flat.items()}
    params = unflatten(paths)
    return Model(
        codec=_representation(description["codec"]),
        autoencoder=params.get("autoencoder"),
        autoencoder_config=AutoencoderConfig(**description["autoencoder"]) if description["autoencoder"] else None,
        denoiser=params.get("denoiser"),
        denoiser_config=_denoiser_config(description["denoiser"]),
        latents=LatentStatistics(**description["latents"]),
        domains=tuple(description["domains"]),
        counts=counts,
        text_encoder=description.get("text_encoder", ""),
        prompts=load_prompts(folder / PROMPTS, description.get("text_encoder", "")),
        count_predictor=params.get("count_predictor"),
        count_predictor_config=CountPredictorConfig(**description["count_predictor"])
        if description.get("count_predictor")
        else None,
        temperature=PerType(**description["temperature"]) if "temperature" in description else DEFAULT_TEMPERATURE,
        energy_guidance=EnergyGuidance(**description["energy_guidance"])
        if description.get("energy_guidance")
        else None,
        notes=description["notes"],
    )


def _representation(fields: dict[str, Any]) -> SceneCodec:
    """JSON turns tuples into lists and enums into numbers; this turns them back."""
    return SceneCodec(
        **{
            **fields,
            "agent_types": tuple(AgentType(kind) for kind in fields["agent_types"]),
            "columns": tuple(fields["columns"]),
            "links": tuple(Link(link) for link in fields["links"]),
            "agent_z": tuple(fields["agent_z"]),
            "lane_z": tuple(fields["lane_z"]),
            "speed": tuple(fields["speed"]),
            "sizes": tuple(tuple(tuple(bounds) for bounds in row) for row in fields["sizes"]),
        }
    )


def _described(config: DenoiserConfig) -> dict[str, Any]:
    """The fields of a denoiser's config; those of ``cross_attention`` with its name, which its type alone would tell."""
    return {**dataclasses.asdict(config), "cross_attention": to_config(config.cross_attention)}


def _denoiser_config(fields: dict[str, Any] | None) -> DenoiserConfig | None:
    if fields is None:
        return None
    condition = fields["condition"]
    if condition is not None:
        kind: Any = ImageCondition if "channels" in condition else TextCondition
        condition = kind(**{name: tuple(v) if isinstance(v, list) else v for name, v in condition.items()})
    return DenoiserConfig(
        **{**fields, "condition": condition, "cross_attention": from_name(**fields["cross_attention"])}
    )
