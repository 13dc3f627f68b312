"""Small random image networks in the layout of Hugging Face, and pictures."""

from __future__ import annotations

import json

import jax
import numpy as np
import safetensors.numpy
from PIL import Image

from scjax.encoders.base import pure_functions
from scjax.encoders.depth import DEPTH_NETWORKS
from scjax.encoders.vision import IMAGE_NETWORKS
from scjax.nn.state_dict import export

_V2 = {"hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2, "mlp_ratio": 2, "image_size": 20}
CONFIGS = {
    "dinov2": {**_V2, "model_type": "dinov2", "patch_size": 4},
    "dinov3_vit": {
        **{"model_type": "dinov3_vit", "hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2},
        **{"intermediate_size": 24, "patch_size": 4, "num_register_tokens": 2},
    },
    "depth_anything": {
        "model_type": "depth_anything",
        "backbone_config": {**_V2, "model_type": "dinov2", "patch_size": 4, "out_features": ["stage1", "stage2"]},
        "neck_hidden_sizes": [4, 6],
        "reassemble_factors": [2, 0.5],
        "fusion_hidden_size": 8,
        "head_hidden_size": 4,
    },
}
"""Model type -> content of a config.json."""


def network_state(kind, config=None):
    """Random weights, as a state dict."""
    network = {**IMAGE_NETWORKS, **DEPTH_NETWORKS}[kind]
    sizes = network.read_config(config or CONFIGS[kind])
    params = jax.tree.map(lambda x: x + 0.1, pure_functions(network, sizes).init(jax.random.key(3)))
    return {name: np.ascontiguousarray(x) for name, x in export(params, network.weight_rules(sizes)).items()}


def write_network(folder, kind="dinov2", prefix="", shards=1, config=None):
    """A folder with config.json and random weights, in one file or in several with an index."""
    folder.mkdir(parents=True, exist_ok=True)
    state = {prefix + name: x for name, x in network_state(kind, config).items()}
    (folder / "config.json").write_text(json.dumps(config or CONFIGS[kind]))
    if shards == 1:
        safetensors.numpy.save_file(state, folder / "model.safetensors")
        return folder
    places = {name: f"model-{i % shards + 1:05d}-of-{shards:05d}.safetensors" for i, name in enumerate(sorted(state))}
    for file in sorted(set(places.values())):
        safetensors.numpy.save_file({n: state[n] for n, place in places.items() if place == file}, folder / file)
    (folder / "model.safetensors.index.json").write_text(json.dumps({"metadata": {}, "weight_map": places}))
    return folder


def picture(height=45, width=80, seed=0):
    """A smooth random picture [height, width, 3]."""
    coarse = np.random.default_rng(seed).integers(0, 256, (6, 8, 3)).astype(np.uint8)
    return np.asarray(Image.fromarray(coarse).resize((width, height), Image.Resampling.BICUBIC))


def write_pictures(folder, number=3):
    """PNG files 0.png, 1.png, ...; every other one in the folder "more"."""
    for index in range(number):
        path = folder / ("more" if index % 2 else "") / f"{index}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture(seed=index)).save(path)
    return folder
