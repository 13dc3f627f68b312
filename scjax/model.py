"""A trained model as a value: parameters, configs and statistics, in one folder of safetensors and JSON."""

from __future__ import annotations

import dataclasses
import json
import shutil
import uuid
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.latents import LatentStatistics
from scjax.nn.functional import Params, flatten, unflatten
from scjax.representation import Representation
from scjax.scene import AgentType, Link

FORMAT = 1
_JSON, _WEIGHTS = "model.json", "weights.safetensors"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Model:
    """Everything that sampling needs. Without a denoiser it only encodes and decodes.

    Attributes:
      representation: types, columns and ranges.
      autoencoder, autoencoder_config: parameters (nested dict) and sizes, or None.
      denoiser, denoiser_config: the same, or None.
      latents: mean and standard deviation of the latents of each kind.
      counts: [domains, layouts, max_lanes + 1, max_agents + 1] probabilities of (N_l, N_o), or None.
      domains: names behind the domain labels.
      notes: free JSON: training data, steps, licence.
    """

    representation: Representation
    latents: LatentStatistics
    domains: tuple[str, ...]
    autoencoder: Params | None = None
    autoencoder_config: AutoencoderConfig | None = None
    denoiser: Params | None = None
    denoiser_config: DenoiserConfig | None = None
    counts: np.ndarray | None = None
    notes: dict[str, Any] = dataclasses.field(default_factory=dict)


def save(model: Model, folder: str | Path) -> Path:
    """Writes ``folder`` (replaced as a whole at the end, never half-written) and returns it."""
    folder = Path(folder)
    description = {
        "format": FORMAT,
        "representation": dataclasses.asdict(model.representation),
        "autoencoder": dataclasses.asdict(model.autoencoder_config) if model.autoencoder_config else None,
        "denoiser": dataclasses.asdict(model.denoiser_config) if model.denoiser_config else None,
        "latents": dataclasses.asdict(model.latents),
        "domains": list(model.domains),
        "notes": model.notes,
    }
    networks = {"autoencoder": model.autoencoder or {}, "denoiser": model.denoiser or {}}
    # safetensors writes an array's memory as it lies, whatever its strides: a transposed one would come back garbled.
    arrays = {".".join(map(str, path)): np.array(leaf, order="C") for path, leaf in flatten(networks).items()}
    if model.counts is not None:
        arrays["counts"] = np.array(model.counts, order="C")
    temporary = folder.with_name(f".{folder.name}.{uuid.uuid4().hex[:8]}")
    temporary.mkdir(parents=True)
    try:
        (temporary / _JSON).write_text(json.dumps(description, indent=1))
        safetensors.numpy.save_file(arrays, temporary / _WEIGHTS, metadata={"format": str(FORMAT)})
        retired = folder.with_name(f"{temporary.name}.old")
        if folder.exists():
            folder.rename(retired)
        temporary.rename(folder)
        shutil.rmtree(retired, ignore_errors=True)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def load(path: str | Path) -> Model:
    """Reads a model folder written by ``save``, by training or by ``python -m scjax.convert``.

    Raises:
      ValueError: if the folder is missing, incomplete, damaged, or of a newer format.
    """
    folder = Path(path)
    if not (folder / _JSON).is_file():
        raise ValueError(f"{folder} is no model folder: it has no {_JSON}. Train one with python -m experiments.train")
    try:
        description = json.loads((folder / _JSON).read_text())
        flat = safetensors.numpy.load_file(folder / _WEIGHTS)
    except (OSError, json.JSONDecodeError, safetensors.SafetensorError) as error:
        raise ValueError(f"{folder} is damaged ({error}): copy or export the model again") from error
    if description.get("format", 0) > FORMAT:
        raise ValueError(f"{folder} has model format {description['format']}, this code reads {FORMAT}: update scjax")
    counts = flat.pop("counts", None)
    paths = {tuple(int(part) if part.isdigit() else part for part in name.split(".")): a for name, a in flat.items()}
    params = unflatten(paths)
    return Model(
        representation=_representation(description["representation"]),
        autoencoder=params.get("autoencoder"),
        autoencoder_config=AutoencoderConfig(**description["autoencoder"]) if description["autoencoder"] else None,
        denoiser=params.get("denoiser"),
        denoiser_config=_denoiser_config(description["denoiser"]),
        latents=LatentStatistics(**description["latents"]),
        domains=tuple(description["domains"]),
        counts=counts,
        notes=description["notes"],
    )


def _representation(fields: dict[str, Any]) -> Representation:
    """JSON turns tuples into lists and enums into numbers; this turns them back."""
    return Representation(
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


def _denoiser_config(fields: dict[str, Any] | None) -> DenoiserConfig | None:
    if fields is None:
        return None
    condition = fields["condition"]
    if condition is not None:
        kind: Any = ImageCondition if "channels" in condition else TextCondition
        condition = kind(**{name: tuple(v) if isinstance(v, list) else v for name, v in condition.items()})
    return DenoiserConfig(**{**fields, "condition": condition})
