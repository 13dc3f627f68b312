"""Checkpoints of the official release -> networks of a ``Model``: sizes follow from shapes, keys are mapped
strictly."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import safetensors.numpy

from scjax.convert.autoencoder import from_official
from scjax.convert.denoiser import convert_denoiser
from scjax.generate.model import Component, Model
from scjax.generate.model_checks import MAX_PARAMETER
from scjax.models import codec as codec
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.latents import LatentStatistics
from scjax.nn.cross_attention import CrossGlobalOptions
from scjax.scene.per_type import PerType

State = dict[str, np.ndarray]

# Shipped with the release (official-spec §2.7), of its nuPlan autoencoder.
NUPLAN_LATENTS = LatentStatistics(
    mean=PerType(agents=-0.0077851, lanes=-0.0458711), std=PerType(agents=0.9948730, lanes=1.0398721)
)
NUPLAN_CITIES = ("pgh", "lav", "sgp", "bos")
MAX_SIZE = 65536
"""Largest width, number of tokens or of heads of a network."""

_LISTED = 20
_MARKER_KEYS = {"autoencoder": "encoder.Q", "denoiser": "model.lane_embedder.linear1.weight"}


def convert_checkpoint(
    path: str | Path, *, into: Model | None = None, heads: Mapping[Any, tuple[int, int]] | None = None
) -> Model:
    """The networks in the checkpoint ``path`` as a model, or added to the model ``into``.

    Args:
      path: safetensors file, or a PyTorch file (a state dict, or a Lightning checkpoint that holds one).
      into: model to complete; None: a new model with the release's nuPlan codec and latent statistics.
      heads: (lane heads, agent heads) of "autoencoder" and "denoiser", which do not follow from shapes; default: the
        release's.

    Raises:
      ValueError: the file is unreadable or holds no known network, entries are unexpected, missing, misshapen, of
        another type or not finite, or heads that do not fit.
    """
    _check_heads(heads)
    state, components = read_state(path), {}
    for name, marker in _MARKER_KEYS.items():
        network_state = _subtree(state, marker)
        if network_state is None:
            continue
        try:
            _check_arrays(network_state)
            components[name] = (_autoencoder if name == "autoencoder" else _denoiser)(network_state, heads)
        except ValueError as error:
            raise ValueError(f"{path}: {name}: {error}") from error
    if not components:
        raise ValueError(
            f"{path} holds neither an autoencoder (key {_MARKER_KEYS['autoencoder']}) nor a denoiser (key "
            f"{_MARKER_KEYS['denoiser']}) of the official release; its first keys are {sorted(state)[:5]}"
        )
    base = into or Model(
        components={},
        codec=codec.official_nuplan(),
        latents=NUPLAN_LATENTS,
        domains=NUPLAN_CITIES,
        notes={"source": f"official release, {Path(path).name}"},
    )
    return dataclasses.replace(base, components={**base.components, **components})


def read_state(path: str | Path) -> State:
    """Key -> array of a safetensors or PyTorch file; only tensors are loaded, never code."""
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    if path.suffix == ".safetensors":
        try:
            return safetensors.numpy.load_file(path)
        except OSError as error:
            raise ValueError(f"{path} cannot be read ({error.strerror or error})") from error
        except Exception as error:  # besides SafetensorError, unknown types of numbers raise several kinds
            raise ValueError(f"{path} is no whole safetensors file ({error}): download it again") from error
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ValueError(
            f"{path} is a PyTorch file, and torch is not installed: pip install 'scjax[convert]', "
            "or save its state dict as safetensors"
        ) from error
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for a damaged or unsafe file
        raise ValueError(f"{path} cannot be read as a plain state dict: {_first_line(error)}") from error
    content = content.get("state_dict", content) if isinstance(content, dict) else content
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds a {type(content).__name__}, not a state dict")
    tensors = {str(key): value for key, value in content.items() if torch.is_tensor(value)}
    try:
        return {key: (value.float() if value.is_floating_point() else value).numpy() for key, value in tensors.items()}
    except Exception as error:  # sparse and quantized tensors raise several kinds
        raise ValueError(f"{path} holds tensors that are no plain arrays: {_first_line(error)}") from error


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _check_heads(heads: Mapping[Any, tuple[int, int]] | None) -> None:
    for name, pair in (heads or {}).items():
        if name not in _MARKER_KEYS:
            raise ValueError(f"heads of {name!r}: choose from {', '.join(_MARKER_KEYS)}")
        if len(pair) != 2 or not all(isinstance(number, int) and 1 <= number <= MAX_SIZE for number in pair):
            raise ValueError(f"heads of the {name} must be two numbers of 1 to {MAX_SIZE}, (lane, agent), not {pair!r}")


def _check_arrays(state: State) -> None:
    """Raises a ValueError that names the arrays that are empty, vast, of another type or not finite."""
    problems = []
    for key, array in sorted(state.items()):
        if not jnp.issubdtype(array.dtype, jnp.floating):
            problems.append(f"{key} is {array.dtype}, not floating-point")
        elif not array.size or max(array.shape, default=1) > MAX_SIZE:
            problems.append(f"{key} has shape {array.shape}: sizes are 1 to {MAX_SIZE}")
        elif not (np.abs(array) < MAX_PARAMETER).all():
            problems.append(f"{key} is not finite, or beyond {MAX_PARAMETER:g}")
    if problems:
        more = f"\n  and {len(problems) - _LISTED} more" if len(problems) > _LISTED else ""
        raise ValueError("these arrays are damaged:\n  " + "\n  ".join(problems[:_LISTED]) + more)


def _subtree(state: State, marker: str) -> State | None:
    """Entries of the network with the key ``marker``, without a wrapper's prefix; None without such a key."""
    prefixes = sorted((key[: -len(marker)] for key in state if key.endswith(marker)), key=len)
    if not prefixes:
        return None
    top = marker.split(".")[0] + "."
    siblings = (top, "decoder.") if top == "encoder." else (top,)
    prefix = prefixes[0]
    stripped = {key[len(prefix) :]: value for key, value in state.items() if key.startswith(prefix)}
    if not prefix:  # a bare state dict is taken whole, so that stray entries are reported
        return {key: value for key, value in stripped.items() if not _belongs_elsewhere(key, marker)}
    return {key: value for key, value in stripped.items() if key.startswith(siblings)}


def _belongs_elsewhere(key: str, marker: str) -> bool:
    """Entries of the other network in a file that holds both."""
    if marker == _MARKER_KEYS["autoencoder"]:
        return key.startswith("model.")
    return not key.startswith("model.") and re.match(r"(\w+\.)?(encoder|decoder)\.", key) is not None


def _blocks(state: State, pattern: str) -> int:
    """How many different numbers match the pattern's group."""
    return len({match[1] for key in state if (match := re.match(pattern, key))})


def _shape(state: State, key: str, axes: tuple[int, ...] = (2,)) -> tuple[int, ...]:
    if key not in state:
        raise ValueError(f"missing: {key}")
    shape = state[key].shape
    if len(shape) not in axes:
        raise ValueError(f"misshapen: {key} is {shape}, but must have {' or '.join(map(str, axes))} axes")
    return shape


def _autoencoder(state: State, heads: Mapping[Any, tuple[int, int]] | None) -> Component[AutoencoderConfig]:
    lane_in, agent_in = (_shape(state, f"encoder.{kind}_mlp.linears.0.weight") for kind in ("lane", "agent"))
    edge = _shape(state, "encoder.lane_conn_mlp.linears.0.weight")
    first = "encoder.encoder_transformer_blocks.0"
    points = _shape(state, "decoder.pred_lane_states.linear_out.weight")[0]
    types = _shape(state, "decoder.pred_agent_types.linear_out.weight")[0]
    lane_heads, agent_heads = (heads or {}).get("autoencoder", (4, 4))
    config = AutoencoderConfig.preset(
        "official",
        lane_types=lane_in[1] - points,
        agent_types=types,
        link_types=edge[1],
        lane_width=lane_in[0],
        agent_width=agent_in[0],
        edge_width=edge[0],
        lane_heads=lane_heads,
        agent_heads=agent_heads,
        lane_ff=_shape(state, f"{first}.l2l_transformer_layer.ff_mlp.0.weight")[0],
        agent_ff=_shape(state, f"{first}.a2a_transformer_layer.ff_mlp.0.weight")[0],
        columns=agent_in[1] - types,
        points=points // 2,
        lane_latent=_shape(state, "encoder.lane_mu.weight")[0],
        agent_latent=_shape(state, "encoder.agent_mu.weight")[0],
        max_lanes=_shape(state, "encoder.pred_lane_cond_dis.linear_out.weight")[0] - 1,
        encoder_blocks=_blocks(state, r"encoder\.encoder_transformer_blocks\.(\d+)\."),
        decoder_blocks=_blocks(state, r"decoder\.decoder_transformer_blocks\.(\d+)\."),
    )
    return Component(config, from_official(state, config))


def _denoiser(state: State, heads: Mapping[Any, tuple[int, int]] | None) -> Component[DenoiserConfig]:
    lane, agent = (_shape(state, f"model.{kind}_embedder.linear1.weight") for kind in ("lane", "agent"))
    condition = None
    if "model.text_embedding_lanes.0.weight" in state:
        condition = TextCondition(width=_shape(state, "model.text_embedding_lanes.0.weight")[1])
    elif "model.dino_proj.weight" in state:
        cells = round(_shape(state, "model.pos_emb_img", (2, 3))[-2] ** 0.5)
        condition = ImageCondition(channels=_shape(state, "model.dino_proj.weight")[1], grid=(cells, cells))
    lane_heads, agent_heads = (heads or {}).get("denoiser", (16, 8))
    latents = next((_shape(state, key, (3,))[1] for key in state if key.endswith("cross_attn.latent_tokens")), 32)
    config = dataclasses.replace(
        DenoiserConfig.preset("official", condition=condition),
        lane_width=lane[0],
        agent_width=agent[0],
        lane_heads=lane_heads,
        agent_heads=agent_heads,
        lane_latent=lane[1],
        agent_latent=agent[1],
        mlp_ratio=_shape(state, "model.blocks.0.a2l_block.mlp.fc1.weight")[0] // lane[0],
        blocks=_blocks(state, r"model\.blocks\.(\d+)\."),
        l2l_stages=_blocks(state, r"model\.blocks\.0\.l2l_blocks\.(\d+)\."),
        max_lanes=_shape(state, "model.num_lanes_embedder.embedding_table.weight")[0] - 1,
        max_agents=_shape(state, "model.num_agents_embedder.embedding_table.weight")[0] - 1,
        domains=(_shape(state, "model.scene_type_embedder.embedding_table.weight")[0] - 1) // 3,
        cross_attention=CrossGlobalOptions(latent_tokens=latents),
    )
    return Component(config, convert_denoiser(state, config))
