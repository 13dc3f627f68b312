"""How ``vit`` reads releases of DINOv2, DINOv2 with registers and DINOv3: their config.json and their weights."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from scjax.encoders.base import CONFIG_CURE, CONFIG_FILE, PublishedNetwork
from scjax.encoders.vit import Vit, VitConfig
from scjax.nn.functional import Path
from scjax.nn.state_dict import DROP_FIRST, SAME, TRANSPOSE, Rules, Transform
from scjax.scene.document import convert_document

_DEFAULTS: dict[str, dict[str, Any]] = {
    # Sizes that the transformers library takes where a config.json does not give them.
    "dinov2": {"hidden_size": 768, "num_attention_heads": 12, "patch_size": 14, "image_size": 224},
    "dinov2_with_registers": {
        **{"hidden_size": 768, "num_attention_heads": 12, "patch_size": 16, "image_size": 224},
        "num_register_tokens": 4,
    },
    "dinov3_vit": {"patch_size": 16, "image_size": 224, "layer_norm_eps": 1e-5, "rope_theta": 100.0, "key_bias": False},
}
_VARIANTS = {
    "hidden_act": ("gelu",),
    "num_channels": (3,),
    "use_swiglu_ffn": (False,),
    "use_gated_mlp": (False,),
    "proj_bias": (True,),
    "mlp_bias": (True,),
}
"""Field -> values that the network covers; absent fields have the first one."""

_DINOV2_KEYS = {
    "query": "attention.attention.query",
    "key": "attention.attention.key",
    "value": "attention.attention.value",
    "out": "attention.output.dense",
    "up": "mlp.fc1",
    "down": "mlp.fc2",
}
_DINOV3_KEYS = {
    "query": "attention.q_proj",
    "key": "attention.k_proj",
    "value": "attention.v_proj",
    "out": "attention.o_proj",
    "up": "mlp.up_proj",
    "down": "mlp.down_proj",
}
_UNUSED = ("embeddings.mask_token", "rope_embeddings.inv_freq", "classifier.weight", "classifier.bias")


def vit_config(content: Mapping[str, Any]) -> VitConfig:
    """Sizes from the content of a ``config.json``.

    Raises:
      ValueError: a field of another type or out of its range, or a variant that the network is not.
    """
    model_type = content.get("model_type")
    if model_type not in _DEFAULTS:
        raise ValueError(f"{CONFIG_FILE}: model_type is {model_type!r}: expected one of {', '.join(_DEFAULTS)}")
    for name, values in _VARIANTS.items():
        if content.get(name, values[0]) not in values:
            raise ValueError(f"{CONFIG_FILE}: {name} is {content[name]!r}: only {values[0]!r} is supported")
    fields = {**_DEFAULTS[model_type], **content}
    for name in ("compute", "antialias_positions"):
        fields.pop(name, None)
    if model_type != "dinov3_vit":
        bias = fields.get("qkv_bias", True)
        fields |= {"query_bias": bias, "key_bias": bias, "value_bias": bias, "rope_theta": None}
        fields |= {"antialias_positions": model_type == "dinov2_with_registers"}
        if model_type == "dinov2":
            fields["num_register_tokens"] = 0
        fields["intermediate_size"] = _inner_size(fields["hidden_size"], fields.get("mlp_ratio", 4))
    return convert_document(fields, VitConfig, CONFIG_FILE, CONFIG_CURE)


def _inner_size(width: Any, ratio: Any) -> int:
    is_number = [isinstance(value, int | float) and not isinstance(value, bool) for value in (width, ratio)]
    if not all(is_number) or not 0 < ratio <= 64 or not 0 < width <= 2**20:
        raise ValueError(f"{CONFIG_FILE}: hidden_size {width!r} and mlp_ratio {ratio!r} give no size: {CONFIG_CURE}")
    return int(width * ratio)


def vit_weight_rules(config: VitConfig, start: str = "", place: Path = ()) -> Rules:
    """Keys of a state dict -> parameters and layout changes.

    Args:
      start: before every key; place: before every path, where the network is a part of another one.
    """
    is_v3 = config.rope_theta is not None
    embeddings = f"{start}embeddings"
    projection = f"{embeddings}.patch_embeddings" + ("" if is_v3 else ".projection")
    rules: dict[str, Any] = {
        f"{projection}.weight": ((*place, "patches", "kernel"), patch_kernel(config.patch_size)),
        f"{projection}.bias": ((*place, "patches", "bias"), SAME),
        f"{embeddings}.cls_token": ((*place, "class_token"), DROP_FIRST),
        **_pair(f"{start}norm" if is_v3 else f"{start}layernorm", (*place, "norm"), "scale", SAME),
    }
    if config.num_register_tokens:
        rules[f"{embeddings}.register_tokens"] = ((*place, "registers"), DROP_FIRST)
    if not is_v3:
        rules[f"{embeddings}.position_embeddings"] = ((*place, "positions"), DROP_FIRST)
    biases = {"query": config.query_bias, "key": config.key_bias, "value": config.value_bias}
    for number in range(config.num_hidden_layers):
        layer = f"{start}layer.{number}" if is_v3 else f"{start}encoder.layer.{number}"
        path = (*place, "layers", number)
        for own, foreign in (_DINOV3_KEYS if is_v3 else _DINOV2_KEYS).items():
            rules |= _pair(f"{layer}.{foreign}", (*path, own), "kernel", TRANSPOSE, bias=biases.get(own, True))
        for part in ("1", "2"):
            rules |= _pair(f"{layer}.norm{part}", (*path, f"norm{part}"), "scale", SAME)
            rules[f"{layer}.layer_scale{part}.lambda1"] = ((*path, f"scale{part}"), SAME)
    return rules


def _pair(foreign: str, path: Path, weight: str, transform: Transform, *, bias: bool = True) -> dict[str, Any]:
    rules: dict[str, Any] = {f"{foreign}.weight": ((*path, weight), transform)}
    return rules | ({f"{foreign}.bias": ((*path, "bias"), SAME)} if bias else {})


def patch_kernel(size: int) -> Transform:
    """A convolution without overlap [out, 3, size, size] there, the matrix [size size 3, out] here."""

    def backward(kernel: np.ndarray) -> np.ndarray:
        return kernel.reshape(size, size, -1, kernel.shape[-1]).transpose(3, 2, 0, 1)

    return Transform(lambda x: x.transpose(2, 3, 1, 0).reshape(-1, len(x)), backward)


def vit_table_shapes(config: VitConfig, start: str = "") -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that decide all sizes."""
    width, patch = config.hidden_size, config.patch_size
    if config.rope_theta is not None:
        shapes = {"embeddings.patch_embeddings.weight": (width, 3, patch, patch)}
        up = "layer.0.mlp.up_proj.weight"
    else:
        shapes = {"embeddings.patch_embeddings.projection.weight": (width, 3, patch, patch)}
        shapes |= {"embeddings.position_embeddings": (1, 1 + config.table_side**2, width)}
        up = "encoder.layer.0.mlp.fc1.weight"
    if config.num_register_tokens:
        shapes |= {"embeddings.register_tokens": (1, config.num_register_tokens, width)}
    shapes |= {up: (config.intermediate_size, width)}
    return {start + name: shape for name, shape in shapes.items()}


def rename_vit(name: str) -> str:
    """The key that hub releases have: no prefix of a model's name, and the older names of DINOv2's attention."""
    name = re.sub(r"^(dinov2|dinov2_with_registers|dinov3_vit)\.", "", name)
    name = re.sub(r"^model\.(?=(layer|embeddings|norm|rope_embeddings)\b)", "", name)
    return rename_attention(name)


def rename_attention(name: str) -> str:
    """DINOv2's attention is named otherwise in memory (transformers 5) than in files."""
    if "encoder.layer." not in name:
        return name
    for own, letter in (("query", "q"), ("key", "k"), ("value", "v"), ("out", "o")):
        name = name.replace(f".attention.{letter}_proj.", f".{_DINOV2_KEYS[own]}.")
    return name


NETWORK = PublishedNetwork(
    read_config=vit_config,
    module=Vit,
    table_shapes=vit_table_shapes,
    weight_rules=vit_weight_rules,
    is_unused=lambda name: name in _UNUSED,
    rename=rename_vit,
)
