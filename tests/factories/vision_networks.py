"""Tiny image networks of the transformers library, random in every parameter, and random folders of our own."""

from __future__ import annotations

import numpy as np

_SIZES = {"hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2}
_V2 = {**_SIZES, "mlp_ratio": 2, "patch_size": 4, "image_size": 20}  # a table of 5 x 5 positions


def _depth_anything(library):
    sizes = {**_V2, "num_hidden_layers": 3}
    backbone = library.Dinov2Config(**sizes, out_indices=[1, 2, 3], reshape_hidden_states=False)
    return library.DepthAnythingForDepthEstimation(
        library.DepthAnythingConfig(
            backbone_config=backbone,
            patch_size=4,
            reassemble_hidden_size=16,
            reassemble_factors=[2, 1, 0.5],
            neck_hidden_sizes=[6, 8, 10],
            fusion_hidden_size=8,
            head_hidden_size=4,
        )
    )


NETWORK_MAKERS = {
    "dinov2": lambda library: library.Dinov2Model(library.Dinov2Config(**_V2)),
    "dinov2_with_registers": lambda library: library.Dinov2WithRegistersModel(
        library.Dinov2WithRegistersConfig(**_V2, num_register_tokens=3)
    ),
    "dinov3_vit": lambda library: library.DINOv3ViTModel(
        library.DINOv3ViTConfig(**_SIZES, intermediate_size=24, patch_size=4, num_register_tokens=3)
    ),
    "depth_anything": _depth_anything,
}
"""Model type -> the module ``transformers`` -> a tiny network."""


def randomize(model, torch, seed=0):
    """The model with every parameter drawn anew, ready to evaluate."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            offset = 0.5 if parameter.ndim == 1 else 0.0
            parameter.copy_(torch.randn(parameter.shape, generator=generator) * 0.2 + offset)
    return model.eval()


def reference(model, pixels, torch):
    """What the library makes of pixels [b, height, width, 3]: features of patches, or the estimate of depth."""
    with torch.no_grad():
        out = model(torch.from_numpy(pixels).permute(0, 3, 1, 2).contiguous())
    if hasattr(out, "predicted_depth"):
        return out.predicted_depth.numpy()
    prefix = 1 + getattr(model.config, "num_register_tokens", 0)
    return np.ascontiguousarray(out.last_hidden_state[:, prefix:].numpy())
