"""Official denoiser state dict -> parameters of ``scjax.models.denoiser``, strictly (parity README §7.2)."""

from __future__ import annotations

from collections.abc import Mapping

import jax
import numpy as np

from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.model import denoiser
from scjax.nn.cross_attention import CrossGlobalOptions
from scjax.nn.functional import Params
from scjax.nn.state_dict import DROP_FIRST, SAME, TRANSPOSE, Path, Rules, convert

_EMBEDDER = {"linear1": ("linears", 0), "linear2": ("linears", 1), "transform_linear": ("skip",)}
_EMBEDDER_NORMS = {"norm1": ("norms", 0), "norm2": ("norms", 1), "transform_norm": ("skip_norm",)}
_STAGE = {
    "attn.to_q": ("q",),
    "attn.to_k": ("k",),
    "attn.to_v": ("v",),
    "attn.proj": ("out",),
    "mlp.fc1": ("up",),
    "mlp.fc2": ("down",),
    "adaLN_modulation.1": ("adaln",),
}
_CROSS = {
    "q_proj": "q",
    "k_proj": "k",
    "v_proj": "v",
    "out_proj": "out",
    "lat_q_proj": "latent_q",
    "lat_k_proj": "latent_k",
    "lat_v_proj": "latent_v",
    "lat_out_proj": "latent_out",
}
_CROSS_NORMS = {
    "q_norm": "q_norm",
    "k_norm": "k_norm",
    "lat_q_norm": "latent_q_norm",
    "lat_norm": "latent_norm",
    "lat_k_norm": "latent_k_norm",
}


def convert_denoiser(state: Mapping[str, np.ndarray], config: DenoiserConfig) -> Params:
    """Parameters from an official state dict, whose keys carry the prefix ``model.``.

    ``config.known_embedding`` must be off, since the release has no such vectors.

    Raises:
      ValueError: listing what is unexpected, missing or misshapen.
    """
    if config.known_embedding:
        raise ValueError("official weights have no known-token vectors: set known_embedding=False (they start at zero)")
    if config.condition is not None and not isinstance(config.cross_attention, CrossGlobalOptions):
        raise ValueError(
            "official weights use cross-global attention: set cross_attention=CrossGlobalOptions(), not "
            f"{config.cross_attention}"
        )
    network = denoiser(config)
    expected = network.shapes()
    ignored = ["model.pos_emb_lane", "model.pos_emb_agent"]  # fixed tables, computed here
    if isinstance(config.condition, ImageCondition):
        ignored.append("model.pos_emb_img")
    return jax.device_put(convert(state, denoiser_rules(config), expected, ignored))


def denoiser_rules(config: DenoiserConfig) -> Rules:
    """Official key -> (path in our parameters, layout change)."""
    rules: dict = {}
    for key, name in (("scene_type", "labels"), ("num_agents", "agent_counts"), ("num_lanes", "lane_counts")):
        rules[f"model.{key}_embedder.embedding_table.weight"] = ((name,), SAME)
    rules |= _linear("model.t_embedder.mlp.0", ("time_in",)) | _linear("model.t_embedder.mlp.2", ("time_out",))
    rules |= _linear("model.downsample_c", ("narrow",))
    for kind in ("lane", "agent"):
        for key, path in _EMBEDDER.items():
            rules |= _linear(f"model.{kind}_embedder.{key}", (f"{kind}_embedder", *path))
        for key, path in _EMBEDDER_NORMS.items():
            rules |= _norm(f"model.{kind}_embedder.{key}", (f"{kind}_embedder", *path))
        rules |= _linear(f"model.pred_{kind}_noise.linear", (f"{kind}_head", "linear"))
        rules |= _linear(f"model.pred_{kind}_noise.adaLN_modulation.1", (f"{kind}_head", "adaln"))
    for block in range(config.blocks):
        source, path = f"model.blocks.{block}", ("blocks", block)
        rules |= _linear(f"{source}.upsample_x_agent", (*path, "agents_up"))
        rules |= _linear(f"{source}.downsample_x_lane", (*path, "lanes_down"))
        for name in ("a2l", "l2a", "a2a"):
            rules |= _stage(f"{source}.{name}_block", (*path, name), config)
        for i in range(config.l2l_stages):
            rules |= _stage(f"{source}.l2l_blocks.{i}", (*path, "l2l", i), config)
    if isinstance(config.condition, TextCondition):
        for kind in ("lanes", "agents"):
            for key, i in (("0", 0), ("2", 1)):
                rules |= _linear(f"model.text_embedding_{kind}.{key}", ("context", kind, i))
    elif isinstance(config.condition, ImageCondition):
        for key, name in (("dino_proj", "dino"), ("depth_proj", "depth"), ("img_to_agent_proj", "agents")):
            rules |= _linear(f"model.{key}", ("context", name))
    return rules


def _stage(key: str, path: Path, config: DenoiserConfig) -> dict:
    rules: dict = {}
    for suffix, name in _STAGE.items():
        rules |= _linear(f"{key}.{suffix}", (*path, *name))
    if config.condition is not None:
        rules |= _linear(f"{key}.adaLN_modulation_cross.1", (*path, "cross_adaln"))
        rules |= cross_global_rules(f"{key}.cross_attn", (*path, "cross"))
    return rules


def cross_global_rules(key: str, path: Path = ()) -> dict:
    """Rules of one cross-global module."""
    rules: dict = {f"{key}.latent_tokens": ((*path, "latents"), DROP_FIRST), f"{key}.gate": ((*path, "gate"), SAME)}
    for suffix, name in _CROSS.items():
        rules |= _linear(f"{key}.{suffix}", (*path, name))
    for suffix, name in _CROSS_NORMS.items():
        rules |= _norm(f"{key}.{suffix}", (*path, name))
    return rules


def _linear(key: str, path: Path) -> dict:
    return {f"{key}.weight": ((*path, "kernel"), TRANSPOSE), f"{key}.bias": ((*path, "bias"), SAME)}


def _norm(key: str, path: Path) -> dict:
    return {f"{key}.weight": ((*path, "scale"), SAME), f"{key}.bias": ((*path, "bias"), SAME)}
