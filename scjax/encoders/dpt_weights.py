"""How ``dpt`` reads releases of Depth Anything: their config.json and their weights."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from scjax.encoders.base import CONFIG_CURE, CONFIG_FILE, PublishedNetwork
from scjax.encoders.dpt import DepthConfig, DepthNetwork
from scjax.encoders.vit_weights import (
    rename_attention,
    vit_config,
    vit_table_shapes,
    vit_weight_rules,
)
from scjax.nn.functional import Path
from scjax.nn.state_dict import SAME, Rules, Transform
from scjax.scene.document import convert_document

_BACKBONE = "backbone."
_CONV = Transform(lambda x: x.transpose(2, 3, 1, 0), lambda x: x.transpose(3, 2, 0, 1))  # OIHW there, HWIO here
_POINTWISE = Transform(lambda x: x[:, :, 0, 0].T, lambda x: x.T[:, :, None, None])  # 1 x 1 kernels as matrices
_UNUSED = re.compile(r"backbone\.embeddings\.mask_token|neck\.fusion_stage\.layers\.0\.residual_layer1\..*")


def depth_config(content: Mapping[str, Any]) -> DepthConfig:
    """Sizes from the content of a ``config.json``.

    Raises:
      ValueError: a field of another type or out of its range, or a variant that the network is not.
    """
    backbone = content.get("backbone_config")
    if not isinstance(backbone, Mapping) or backbone.get("model_type") != "dinov2":
        raise ValueError(f"{CONFIG_FILE}: backbone_config must be that of a dinov2: {CONFIG_CURE}")
    vit = vit_config(backbone)
    if content.get("head_in_index", -1) != -1:
        raise ValueError(f"{CONFIG_FILE}: head_in_index is {content['head_in_index']!r}: only -1 is supported")
    for name, value in (("patch_size", vit.patch_size), ("reassemble_hidden_size", vit.hidden_size)):
        if content.get(name, value) != value:
            raise ValueError(f"{CONFIG_FILE}: {name} is {content[name]!r}, but the backbone has {value}: {CONFIG_CURE}")
    if backbone.get("apply_layernorm", True) is not True:
        raise ValueError(f"{CONFIG_FILE}: backbone_config.apply_layernorm must be true: {CONFIG_CURE}")
    fields = {**content, "backbone": {**vit.__dict__}, "max_depth": content.get("max_depth") or 1}
    fields["layers"] = _layers(backbone, vit.num_hidden_layers)
    return convert_document(fields, DepthConfig, CONFIG_FILE, CONFIG_CURE)


def _layers(backbone: Mapping[str, Any], most: int) -> list[int]:
    """The layers that ``out_indices`` counts, or ``out_features`` names."""
    layers = backbone.get("out_indices")
    if layers is None:
        names = backbone.get("out_features") or ()
        layers = [int(name[5:]) for name in names if re.fullmatch(r"stage\d{1,4}", str(name))]
    if not isinstance(layers, list | tuple) or not all(type(layer) is int for layer in layers) or not layers:
        raise ValueError(
            f"{CONFIG_FILE}: backbone_config names no layers by out_indices or out_features: {CONFIG_CURE}"
        )
    return [layer if layer >= 0 else layer + most + 1 for layer in layers]


def depth_weight_rules(config: DepthConfig) -> Rules:
    """Keys of a transformers state dict -> parameters and layout changes."""
    rules = dict(vit_weight_rules(config.backbone, _BACKBONE, ("backbone",)))
    for number, factor in enumerate(config.reassemble_factors):
        start, path = f"neck.reassemble_stage.layers.{number}", ("reassemble", number)
        rules |= _conv(f"{start}.projection", (*path, "projection"), _POINTWISE)
        if factor > 1:
            rules[f"{start}.resize.weight"] = ((*path, "resize", "linear", "kernel"), expansion_kernel(int(factor)))
            rules[f"{start}.resize.bias"] = ((*path, "resize", "bias"), SAME)
        elif factor < 1:
            rules |= _conv(f"{start}.resize", (*path, "resize"))
        rules[f"neck.convs.{number}.weight"] = (("convs", number, "kernel"), _CONV)
        start, path = f"neck.fusion_stage.layers.{number}", ("fusions", number)
        rules |= _conv(f"{start}.projection", (*path, "projection"))
        for foreign, own in (("residual_layer1", "skip"), ("residual_layer2", "unit")):
            if own == "skip" and number == 0:
                continue
            rules |= _conv(f"{start}.{foreign}.convolution1", (*path, own, "first"))
            rules |= _conv(f"{start}.{foreign}.convolution2", (*path, own, "second"))
    for number in range(3):
        rules |= _conv(f"head.conv{number + 1}", ("head", number))
    return rules


def _conv(foreign: str, path: Path, transform: Transform = _CONV) -> dict[str, Any]:
    return {f"{foreign}.weight": ((*path, "kernel"), transform), f"{foreign}.bias": ((*path, "bias"), SAME)}


def expansion_kernel(factor: int) -> Transform:
    """A transposed convolution [in, out, factor, factor] there, the matrix [in, factor factor out] here."""

    def backward(kernel: np.ndarray) -> np.ndarray:
        return kernel.reshape(len(kernel), factor, factor, -1).transpose(0, 3, 1, 2)

    return Transform(lambda x: x.transpose(0, 2, 3, 1).reshape(len(x), -1), backward)


def depth_table_shapes(config: DepthConfig) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that decide all sizes."""
    width = config.backbone.hidden_size
    shapes: dict[str, tuple[int, ...]] = dict(vit_table_shapes(config.backbone, _BACKBONE))
    for number, channels in enumerate(config.neck_hidden_sizes):
        shapes[f"neck.reassemble_stage.layers.{number}.projection.weight"] = (channels, width, 1, 1)
        shapes[f"neck.convs.{number}.weight"] = (config.fusion_hidden_size, channels, 3, 3)
    shapes["head.conv2.weight"] = (config.head_hidden_size, config.fusion_hidden_size // 2, 3, 3)
    return shapes


NETWORK = PublishedNetwork(
    read_config=depth_config,
    module=DepthNetwork,
    table_shapes=depth_table_shapes,
    weight_rules=depth_weight_rules,
    is_unused=lambda name: _UNUSED.fullmatch(name) is not None,
    rename=rename_attention,
)
