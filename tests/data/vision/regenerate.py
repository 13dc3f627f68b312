"""Writes the fixtures beside this file: tiny random networks, an input and what the transformers library makes of it.

python tests/data/vision/regenerate.py (needs the extra ``parity``). Every parameter is drawn anew, so that no bias,
norm or LayerScale has its initial value.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import safetensors.numpy
import torch
import transformers

from tests.factories.vision_networks import NETWORK_MAKERS, randomize, reference

FOLDER = Path(__file__).parent
PIXELS = {"dinov2": (12, 20), "dinov2_with_registers": (8, 20), "dinov3_vit": (12, 20), "depth_anything": (12, 20)}


def main() -> None:
    """Writes a folder for each network."""
    for name, make in NETWORK_MAKERS.items():
        model = randomize(make(transformers), torch)
        folder = FOLDER / name
        model.save_pretrained(folder)
        config = json.loads((folder / "config.json").read_text())
        (folder / "config.json").write_text(json.dumps(config, indent=1, sort_keys=True) + "\n")
        pixels = np.random.default_rng(0).normal(size=(2, *PIXELS[name], 3)).astype(np.float32)
        arrays = {"pixels": pixels, "expected": reference(model, pixels, torch)}
        safetensors.numpy.save_file(arrays, folder / "reference.safetensors")


if __name__ == "__main__":
    main()
