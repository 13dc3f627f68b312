"""Weights of the official autoencoder (a PyTorch state dict as NumPy arrays) <-> our parameters.

official-spec §2; §7.1 of the parity set's README lists the keys. The official forward pass never uses two groups of
parameters, which have no counterpart here: the second pre-norm of the lane-to-agent and query attention,
and the edge update of the last encoder block.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.model import autoencoder
from scjax.nn.state_dict import SAME, TRANSPOSE, Path, Transform, convert, export

_Rules = dict[str, tuple[Path, Transform]]

_ATTENTION = {
    "to_q": "query",
    "to_k": "key",
    "to_v": "value",
    "to_s": "skip",
    "to_g": "gate",
    "to_out": "out",
    "ff_mlp.0": "ff_in",
    "ff_mlp.3": "ff_out",
}
_ATTENTION_NORMS = {
    "attn_prenorm_x_src": "norm",
    "attn_postnorm": "out_norm",
    "ff_prenorm": "ff_norm",
    "ff_postnorm": "ff_out_norm",
}
_LAYERS = {
    "l2l_transformer_layer": "lane_lane",
    "l2a_transformer_layer": "lane_agent",
    "a2a_transformer_layer": "agent_agent",
}
_BLOCKS = {"encoder": "encoder.encoder_transformer_blocks", "decoder": "decoder.decoder_transformer_blocks"}


def from_official(state: Mapping[str, np.ndarray], config: AutoencoderConfig) -> dict[str, Any]:
    """Parameters of ``autoencoder(config)`` from an official state dict.

    Raises:
      ValueError: listing every unexpected, missing and misshapen entry.
    """
    expected = autoencoder(config).shapes()
    return convert(state, autoencoder_rules(config), expected, unused_sizes(config), aliases(config))


def to_official(params: Any, config: AutoencoderConfig) -> dict[str, np.ndarray]:
    """Official state dict of parameters (or gradients), without never-used entries and aliases."""
    return export(params, autoencoder_rules(config))


def autoencoder_rules(config: AutoencoderConfig) -> _Rules:
    """Official key -> (path in our parameters, layout change)."""
    rules: _Rules = {"encoder.Q": (("encoder", "query"), SAME)}
    mlps = {
        "encoder.lane_mlp": ("lane_in", 2, False),
        "encoder.agent_mlp": ("agent_in", 2, False),
        "encoder.lane_conn_mlp": ("link_in", 2, False),
        "encoder.pred_lane_cond_dis": ("lane_count", 2, True),
        "decoder.pred_agent_states": ("agent_states", 3, True),
        "decoder.pred_agent_types": ("agent_types", 2, True),
        "decoder.pred_lane_states": ("lane_points", 3, True),
        "decoder.pred_lane_conn": ("links", 2, True),
    }
    if config.lane_types:
        mlps["decoder.pred_lane_types"] = ("lane_types", 2, True)
    for key, (name, depth, out) in mlps.items():
        rules |= _residual_mlp(key, (key.split(".")[0], name), depth, out)
    linears = {
        "encoder.lane_mu": "lane_mean",
        "encoder.lane_log_var": "lane_logvar",
        "encoder.agent_mu": "agent_mean",
        "encoder.agent_log_var": "agent_logvar",
        "decoder.lane_mlp": "lane_in",
        "decoder.agent_mlp": "agent_in",
        "decoder.downsample_lane_mlp": "pair_down",
        "decoder.lane_conn_mlp": "pair_in",
    }
    for key, name in linears.items():
        rules |= _linear(key, (key.split(".")[0], name))
    rules |= _attention("encoder.l2q_transformer_layer", ("encoder", "query_attention"), edges=False)
    for half, i, key in _blocks(config):
        path: Path = (half, "blocks", i)
        for official, ours in _LAYERS.items():
            rules |= _attention(f"{key}.{official}", (*path, ours), edges=ours == "lane_lane")
        rules |= _linear(f"{key}.downsample_lane_emb", (*path, "down"))
        if not _is_dead(half, i, config):
            for mlp, ours in (("node_mlp", "nodes"), ("edge_mlp", "edges")):
                rules |= _residual_mlp(f"{key}.update_edge_embeddings.{mlp}", (*path, "edge_update", ours), 2, False)
    return rules


def aliases(config: AutoencoderConfig) -> dict[str, str]:
    """Official keys that repeat another one: both pre-norms of self-attention layers are the same object."""
    return {
        f"{key}.{layer}.attn_prenorm_x_dst.{leaf}": f"{key}.{layer}.attn_prenorm_x_src.{leaf}"
        for _, _, key in _blocks(config)
        for layer in ("l2l_transformer_layer", "a2a_transformer_layer")
        for leaf in ("weight", "bias")
    }


def unused_sizes(config: AutoencoderConfig) -> dict[str, int]:
    """Official parameters that no forward pass reads -> number of scalars.

    The official parameter count is ours plus their sum.
    """
    sizes = {}
    norms = [(f"{key}.l2a_transformer_layer", config.agent_width) for _, _, key in _blocks(config)]
    for layer, width in [*norms, ("encoder.l2q_transformer_layer", config.lane_width)]:
        sizes |= {f"{layer}.attn_prenorm_x_dst.{leaf}": width for leaf in ("weight", "bias")}
    width = config.edge_width
    for half, i, key in _blocks(config):
        if _is_dead(half, i, config):
            for mlp, inputs in (("node_mlp", 2 * config.agent_width), ("edge_mlp", 2 * width)):
                for official, (path, _) in _residual_mlp(f"{key}.update_edge_embeddings.{mlp}", (), 2, False).items():
                    rows = 1 if path[-1] != "kernel" else inputs if path[:2] != ("linears", 1) else width
                    sizes[official] = rows * width
    return sizes


def _blocks(config: AutoencoderConfig) -> list[tuple[str, int, str]]:
    """(half, index, official key) of every factorized block."""
    counts = {"encoder": config.encoder_blocks, "decoder": config.decoder_blocks}
    return [(half, i, f"{_BLOCKS[half]}.{i}") for half, count in counts.items() for i in range(count)]


def _is_dead(half: str, i: int, config: AutoencoderConfig) -> bool:
    return half == "encoder" and i + 1 == config.encoder_blocks


def _linear(key: str, path: Path, bias: bool = True) -> _Rules:
    rules: _Rules = {f"{key}.weight": ((*path, "kernel"), TRANSPOSE)}
    return rules | ({f"{key}.bias": ((*path, "bias"), SAME)} if bias else {})


def _norm(key: str, path: Path) -> _Rules:
    return {f"{key}.weight": ((*path, "scale"), SAME), f"{key}.bias": ((*path, "bias"), SAME)}


def _residual_mlp(key: str, path: Path, depth: int, out: bool) -> _Rules:
    rules = _linear(f"{key}.transform_linear", (*path, "skip")) | _norm(f"{key}.transform_norm", (*path, "skip_norm"))
    for k in range(depth):
        rules |= _linear(f"{key}.linears.{k}", (*path, "linears", k)) | _norm(f"{key}.norms.{k}", (*path, "norms", k))
    return rules | (_linear(f"{key}.linear_out", (*path, "out")) if out else {})


def _attention(key: str, path: Path, edges: bool) -> _Rules:
    rules: _Rules = {}
    for official, ours in _ATTENTION.items():
        rules |= _linear(f"{key}.{official}", (*path, ours), bias=official != "to_k")
    for official, ours in _ATTENTION_NORMS.items():
        rules |= _norm(f"{key}.{official}", (*path, ours))
    if edges:
        rules |= _linear(f"{key}.to_k_r", (*path, "edge_key"), bias=False)
        rules |= _linear(f"{key}.to_v_r", (*path, "edge_value"))
        rules |= _norm(f"{key}.attn_prenorm_r", (*path, "edge_norm"))
    return rules
