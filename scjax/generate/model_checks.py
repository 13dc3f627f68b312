"""Whether the parts of a model are sound and fit each other: types, ranges, shapes, finite values."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from scjax.diffusion.defaults import NUM_TRAIN_TIMESTEPS
from scjax.diffusion.guidance import MAX_SCALE
from scjax.generate.components import COMPONENTS, Model
from scjax.models.codec import SceneCodec
from scjax.models.denoiser.kinds import NO_KIND
from scjax.nn.functional import flatten
from scjax.scene import Crop
from scjax.scene.arguments import finite_number, whole_number

_MAX_SIZE, _MAX_BLOCKS = 1 << 20, 256
MAX_PARAMETER = 1e9
"""Larger values of a parameter overflow in products."""

_MAX_RANGE = 1e4  # m, m/s


def check_model(model: Model) -> None:
    """Checks every part of a model, and that the parts fit each other.

    Raises:
      ValueError: names the part and the field or array.
    """
    check_codec(model.codec)
    for name, component in model.components.items():
        check_network_config(name, component.config)
        _check_params(name, component.config, component.params)
    _check_fit(model)
    if not all(isinstance(domain, str) and domain for domain in model.domains):
        raise ValueError("domains must be names")
    if len(set(model.domains)) < len(model.domains):
        raise ValueError("domains holds a name twice")
    for label, pair in (("latents.mean", model.latents.mean), ("latents.std", model.latents.std)):
        for value in jax.tree.leaves(pair):
            finite_number(value, label, -1e6, 1e6)
    for value in jax.tree.leaves(model.temperature):
        finite_number(value, "temperature", 1e-6, 100.0)
    if model.num_steps is not None:
        whole_number(model.num_steps, "num_steps", 2, NUM_TRAIN_TIMESTEPS)
    if model.guidance is not None:
        finite_number(model.guidance, "guidance", -MAX_SCALE, MAX_SCALE)
    if model.counts is not None:
        _check_counts(model)
    if model.outlines is not None:
        _check_outlines(model)
    if model.views is not None:
        model.views.check()
        if "denoiser" in model.components:
            config = model.components["denoiser"].config
            if (model.views.lane_sizes, model.views.agent_sizes) != (config.lane_kinds, config.agent_kinds):
                raise ValueError("view outlines: they have kinds of other sizes than the denoiser")


def check_network_config(name: str, config: Any) -> None:
    """Types and sizes of the plain fields of a network's config.

    Raises:
      ValueError: names the component and the field.
    """
    for field in dataclasses.fields(config):
        value, where = getattr(config, field.name), f"{name}.{field.name}"
        if dataclasses.is_dataclass(value):
            check_network_config(where, value)
        elif field.type == "int":
            most = _MAX_BLOCKS if field.name.endswith(("blocks", "stages")) else _MAX_SIZE
            if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
                raise ValueError(f"{where} must be a whole number in 0..{most}, not {value!r:.80}")
        elif field.type == "float":
            finite_number(value, where)
        elif field.type == "bool" and not isinstance(value, bool):
            raise ValueError(f"{where} must be true or false, not {value!r:.80}")


def check_codec(codec: SceneCodec) -> None:
    """Ranges of a codec: finite, increasing, within 10 km and 10,000 m/s.

    Raises:
      ValueError: names the field.
    """
    if not isinstance(codec.name, str):
        raise ValueError(f"codec.name must be a text, not {codec.name!r:.80}")
    ranges = {"agent_z": codec.agent_z, "lane_z": codec.lane_z, "speed": codec.speed}
    for row, sizes in enumerate(codec.sizes):
        if len(sizes) != 3:
            raise ValueError(f"codec.sizes[{row}] must be the ranges of length, width and height, not {sizes}")
        ranges |= {f"sizes[{row}][{column}]": bounds for column, bounds in enumerate(sizes)}
    for name, bounds in ranges.items():
        if len(bounds) != 2:
            raise ValueError(f"codec.{name} must be (least, most), not {bounds}")
        low, high = (finite_number(bound, f"codec.{name}", -_MAX_RANGE, _MAX_RANGE) for bound in bounds)
        if low >= high:
            raise ValueError(f"codec.{name} must increase, not be {bounds}")
    finite_number(codec.clip_lanes, "codec.clip_lanes", 0.1, 1e6)
    for name, choices in (("lane_classes", ("signal", "lights", "none")), ("forward", ("x", "y"))):
        if getattr(codec, name) not in choices:
            raise ValueError(f"codec.{name} must be one of {', '.join(choices)}, not {getattr(codec, name)!r:.80}")
    for name in ("agent_types", "columns", "links"):
        values = getattr(codec, name)
        if not values or len(set(values)) < len(values):
            raise ValueError(f"codec.{name} must hold different values, at least one")


def check_arrays(arrays: Mapping[str, np.ndarray]) -> None:
    """Refuses NaN, infinity and absurd values: a training that diverged, or damage.

    Raises:
      ValueError: names the first such array.
    """
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not (np.abs(array) < MAX_PARAMETER).all():
            raise ValueError(
                f"the array {name} holds NaN, infinity or values beyond {MAX_PARAMETER:g}: its training diverged, or "
                "the file is damaged"
            )


def _check_params(name: str, config: Any, params: Any) -> None:
    expected = flatten(jax.eval_shape(COMPONENTS[name].network(config).init, jax.random.key(0)))
    given = flatten(params)
    if missing := [path for path in expected if path not in given]:
        raise ValueError(f"{name}: {len(missing)} arrays are missing, the first is {_dotted(missing[0])}")
    if surplus := [path for path in given if path not in expected]:
        raise ValueError(f"{name}: {len(surplus)} arrays fit no part of it, the first is {_dotted(surplus[0])}")
    for path, leaf in expected.items():
        if np.shape(given[path]) != leaf.shape:
            raise ValueError(
                f"{name}: {_dotted(path)} has shape {np.shape(given[path])}, its config calls for {leaf.shape}"
            )
        if np.asarray(given[path]).dtype.kind != "f" and "float" not in str(given[path].dtype):
            raise ValueError(f"{name}: {_dotted(path)} has the type {given[path].dtype}, not a float")
    check_arrays({f"{name}.{_dotted(path)}": np.asarray(leaf) for path, leaf in given.items()})


def _dotted(path: Any) -> str:
    return ".".join(map(str, path))


def _check_fit(model: Model) -> None:
    """Numbers that two parts share."""
    configs = {name: component.config for name, component in model.components.items()}
    codec, coder, network = model.codec, configs.get("autoencoder"), configs.get("denoiser")
    shared: list[tuple[str, Any, str, Any]] = []
    if coder is not None:
        for field, value in (
            ("lane_types", codec.num_lane_types),
            ("agent_types", len(codec.agent_types)),
            ("link_types", len(codec.links)),
            ("columns", len(codec.columns)),
            ("point_dims", codec.point_dims),
        ):
            shared.append((f"autoencoder.{field}", getattr(coder, field), "codec", value))
    if coder is not None and network is not None:
        for field in ("lane_latent", "agent_latent"):
            shared.append((f"denoiser.{field}", getattr(network, field), f"autoencoder.{field}", getattr(coder, field)))
    if network is not None:
        shared.append(("denoiser.domains", network.domains, "the number of domains", len(model.domains)))
        shared.append(("denoiser.crops", network.crops, "the number of crops", len(Crop)))
    if (counts := configs.get("count_predictor")) is not None:
        shared.append(("count_predictor.domains", counts.domains, "the number of domains", len(model.domains)))
        if network is not None and hasattr(network.condition, "width") and not counts.attributes:
            width = network.condition.width
            shared.append(("count_predictor.text_width", counts.text_width, "denoiser.condition.width", width))
    for name, value, other, expected in shared:
        if value != expected:
            raise ValueError(f"{name} is {value}, but {other} is {expected}: these parts belong to different models")
    for text, features in model.prompts.items():
        width = getattr(network.condition, "width", None) if network is not None else None
        if features.ndim != 2 or (width is not None and features.shape[1] != width):
            raise ValueError(f"the features of the prompt {text[:60]!r} have shape {features.shape}")
    check_arrays({f"prompts: {text[:60]}": features for text, features in model.prompts.items()})


def _check_counts(model: Model) -> None:
    table = model.counts
    assert table is not None
    if table.ndim != 4 or table.shape[:2] != (len(model.domains), len(Crop)):
        raise ValueError(f"counts has shape {table.shape}: it must be [domains, crops, lanes + 1, agents + 1]")
    if table.dtype.kind != "f" or not np.isfinite(table).all() or (table < 0).any() or not table.sum() > 0:
        raise ValueError("counts must hold probabilities: finite numbers of at least 0, not all 0")
    if "denoiser" in model.components:
        config = model.components["denoiser"].config
        if table.shape[2] > config.max_lanes + 1 or table.shape[3] > config.max_agents + 1:
            raise ValueError(f"counts has shape {table.shape}: the denoiser has fewer lanes or agents at most")
    if not math.isfinite(float(table.sum())):
        raise ValueError("counts sums to infinity")


def _check_outlines(model: Model) -> None:
    outlines = model.outlines
    assert outlines is not None
    outlines.check()
    if "denoiser" in model.components:
        config = model.components["denoiser"].config
        for name, kinds, sizes in (
            ("lanes", outlines.lanes, config.lane_kinds),
            ("agents", outlines.agents, config.agent_kinds),
        ):
            if ((kinds < NO_KIND) | (kinds >= max(math.prod(sizes), 1))).any():
                raise ValueError(f"outlines: {name} has kinds that the denoiser does not know")
        if outlines.lanes.shape[1] > config.max_lanes or outlines.agents.shape[1] > config.max_agents:
            raise ValueError("outlines: the denoiser has fewer lanes or agents at most")
        ahead = outlines.ahead
        if ahead is not None and not (
            ((ahead.lanes >= NO_KIND) & (ahead.lanes < math.prod(config.lane_kinds))).all()
            and ((ahead.agents >= NO_KIND) & (ahead.agents < math.prod(config.agent_kinds))).all()
        ):
            raise ValueError("outlines: continuations have kinds that the denoiser does not know")
    if not ((outlines.domains >= 0) & (outlines.domains < max(len(model.domains), 1))).all():
        raise ValueError("outlines: domains are outside those of the model")
