"""The fields of every training config with their types and ranges, checked before anything is read or allocated."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import json
from collections.abc import Iterable
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from msgspec import UNSET, Meta, UnsetType

from scjax.encoders.dashcam_network import DashcamConfig
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.loss import LossWeights
from scjax.models.behavior.config import BehaviorConfig
from scjax.models.counts.predictor import CountPredictorConfig
from scjax.models.denoiser.config import DenoiserConfig
from scjax.nn.cross_attention import OPTIONS
from scjax.scene.document import convert_document

MAX_SIZE = 65536
"""Largest batch, width or other size of a network."""

_CURE = "give another value with --config.FIELD=VALUE"

Size: TypeAlias = Annotated[int, Meta(ge=1, le=MAX_SIZE)]
Steps: TypeAlias = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Every: TypeAlias = Annotated[int, Meta(ge=0, le=2**31 - 1)]
Seed: TypeAlias = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Share: TypeAlias = Annotated[float, Meta(ge=0, le=1)]
Weight: TypeAlias = Annotated[float, Meta(ge=0, le=1e6)]
Decay: TypeAlias = Annotated[float, Meta(ge=0, lt=1)]
Crops: TypeAlias = tuple[Weight, Weight, Weight]
Pair: TypeAlias = tuple[Size, Size]


class _Fields(msgspec.Struct, forbid_unknown_fields=True):
    """Base of the tables below."""


def _fields_of(kind: type, *without: str) -> type[msgspec.Struct]:
    """A table of the fields of a dataclass, whose integers are at most ``MAX_SIZE``, and whose numbers are finite."""
    bounds: dict[Any, Any] = {
        int: Annotated[int, Meta(ge=-MAX_SIZE, le=MAX_SIZE)],
        float: Annotated[float, Meta(ge=-1e6, le=1e6)],
    }
    types: dict[str, Any] = {
        **inspect.get_annotations(kind, eval_str=True),
        "condition": None,
    }  # set by config.condition
    fields = []
    for field in dataclasses.fields(kind):
        if field.name not in without:
            bounded = bounds.get(types[field.name], types[field.name])
            has_default = field.default is not dataclasses.MISSING
            fields.append((field.name, bounded, field.default) if has_default else (field.name, bounded))
    fields.sort(key=len)  # those without a default first
    return msgspec.defstruct(kind.__name__, fields, forbid_unknown_fields=True)


class _Batch(_Fields):
    batch_size: Size
    buckets: Annotated[tuple[Pair, ...], Meta(min_length=1, max_length=64)]
    crops: Crops
    jitter_position: Annotated[float, Meta(ge=0, le=80)]
    jitter_heading: Annotated[float, Meta(ge=0, le=180)]
    order: Literal["shuffle", "recursive"]
    seed: Seed
    workers: Annotated[int, Meta(ge=1, le=1024)]
    text_slots: Size = 96


class _Optimizer(_Fields):
    kind: Literal["adamw", "muon"]
    learning_rate: Annotated[float, Meta(ge=0, le=1e3)]
    warmup: Every
    schedule: Literal["linear", "constant"]
    weight_decay: Annotated[float, Meta(ge=0, le=1e3)]
    clip: Annotated[float, Meta(gt=0, le=1e30)] | None
    b1: Decay | UnsetType = UNSET
    b2: Decay | UnsetType = UNSET
    eps: Annotated[float, Meta(gt=0, le=1)] | UnsetType = UNSET

    def __post_init__(self):
        if self.kind == "muon" and not (self.b1 is self.b2 is self.eps is UNSET):
            raise ValueError('kind "muon" has no fields b1, b2 and eps')


class _AnyRun(_Fields, kw_only=True):
    """Fields of every objective."""

    objective: str
    seed: Seed
    sharding: Literal["flat", "fsdp"]
    steps: Steps
    optimizer: _Optimizer
    ema_decay: Decay
    log_every: Steps
    evaluate_every: Every
    picture_every: Every
    checkpoint_every: Steps
    export_at: tuple[Every, ...]
    tensorboard: bool


class _Run(_AnyRun, kw_only=True):
    """Fields of the objectives that read records."""

    records: str
    batch: _Batch


class _AutoencoderLoss(_Fields):
    weights: _fields_of(LossWeights)  # pyright: ignore[reportInvalidTypeForm]
    balanced_links: bool
    official_lane_count: bool
    typical_counts: Annotated[tuple[Annotated[float, Meta(gt=0, le=1e6)], ...], Meta(max_length=2)]

    def __post_init__(self):
        if len(self.typical_counts) == 1:
            raise ValueError("typical_counts must be (agents, lanes), or ()")


class _AutoencoderRun(_Run, kw_only=True):
    codec: Literal["official_nuplan", "scjax"]
    init_from: str
    model: _fields_of(AutoencoderConfig)  # pyright: ignore[reportInvalidTypeForm]
    loss: _AutoencoderLoss


class _DenoiserLoss(_Fields):
    times: Literal["uniform", "logit-normal"]
    continuous_times: bool
    label_dropout: Share
    condition_dropout: Share
    kind_dropout: Share
    known_lanes_share: Share
    known_region_share: Share
    count_known: bool
    collision: Weight
    connections: Weight
    lateral_offsets: Weight


class _PositionHeadFit(_Fields):
    batches: Size
    steps: Steps


class _DenoiserRun(_Run, kw_only=True):
    autoencoder: str
    condition: Literal["none", "text", "image"]
    images: str
    image_depth: bool
    attributes: bool
    init_from: str
    freeze: bool
    model: _fields_of(DenoiserConfig, "cross_attention", "attributes", "agent_kinds", "lane_kinds")  # pyright: ignore[reportInvalidTypeForm]
    cross_attention: str
    cross_attention_options: dict[str, dict[str, Any]]
    loss: _DenoiserLoss
    position_head_fit: _PositionHeadFit


class _CountsRun(_Run, kw_only=True):
    condition: Literal["text", "attributes"]
    denoiser: str
    model: _fields_of(CountPredictorConfig, "text_width", "attributes", "domains")  # pyright: ignore[reportInvalidTypeForm]
    domain_dropout: Share


class _MotionBatch(_Fields):
    batch_size: Size
    agents: Annotated[int, Meta(ge=2, le=1024)]
    trained: Annotated[int, Meta(ge=1, le=1024)]
    unknown_past: Share
    seed: Seed

    def __post_init__(self):
        if self.trained > self.agents:
            raise ValueError("trained must be at most agents")


class _BehaviorRun(_AnyRun, kw_only=True):
    logs: str
    cache: str
    rolls: Annotated[int, Meta(ge=1, le=100)]
    init_from: str
    batch: _MotionBatch
    model: _fields_of(BehaviorConfig)  # pyright: ignore[reportInvalidTypeForm]
    return_weight: Weight


class _PictureBatch(_Fields):
    batch_size: Size
    mirror: Share
    brightness: Annotated[float, Meta(ge=0, le=2)]
    tint: Annotated[float, Meta(ge=0, le=2)]
    cut: Share
    seed: Seed


class _VisionLoss(_Fields):
    classes: Weight
    depth: Weight
    objects: Weight
    lanes: Weight


class _VisionRun(_AnyRun, kw_only=True):
    pictures: str
    init_from: str
    batch: _PictureBatch
    model: _fields_of(DashcamConfig)  # pyright: ignore[reportInvalidTypeForm]
    loss: _VisionLoss


RUNS: dict[str, type[_AnyRun]] = {
    "autoencoder": _AutoencoderRun,
    "denoiser": _DenoiserRun,
    "counts": _CountsRun,
    "behavior": _BehaviorRun,
    "vision": _VisionRun,
}
"""``config.objective`` -> its fields."""


def check_config(config: Any) -> dict[str, Any]:
    """The values of a training config (an ``ml_collections.ConfigDict``) as plain JSON values, once they are checked.

    Raises:
      ValueError: a field is unknown, missing, of another type or out of its range; the message has its path.
    """
    try:
        resolved = json.loads(config.to_json())
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"config: holds a value that is neither number, text, list nor table ({error})") from error
    objective = resolved.get("objective")
    if not isinstance(objective, str) or objective not in RUNS:
        raise ValueError(f"config.objective is {objective!r}: choose one of {', '.join(RUNS)}")
    check_names(resolved, RUNS[objective])
    convert_document(resolved, RUNS[objective], "config", _CURE)
    for name, options in resolved.get("cross_attention_options", {}).items():
        if name not in OPTIONS:
            raise ValueError(f"config: cross_attention_options.{name}: no such mechanism: {', '.join(OPTIONS)}")
        convert_document(options, _fields_of(OPTIONS[name]), f"config: cross_attention_options.{name}", _CURE)
    return resolved


def check_names(values: dict[str, Any], fields: type[msgspec.Struct], prefix: str = "config") -> None:
    """Refuses fields that a table does not have, with the nearest name that it has.

    Raises:
      ValueError: an unknown field.
    """
    known = {field.name: field.type for field in msgspec.structs.fields(fields)}
    for name, value in values.items():
        if name not in known:
            raise ValueError(f"{prefix}.{name} is unknown{_nearest(name, known)}")
        kind = known[name]
        if isinstance(value, dict) and isinstance(kind, type) and issubclass(kind, msgspec.Struct):
            check_names(value, kind, f"{prefix}.{name}")


def _nearest(name: str, known: Iterable[str]) -> str:
    matches = difflib.get_close_matches(name, list(known), 1)
    return f": did you mean {matches[0]}?" if matches else ""
