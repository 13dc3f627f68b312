"""Token features of texts in a file of their own: prompts that ship with a model need no encoder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy


def write_prompts(features: Mapping[str, np.ndarray], encoder: str, path: str | Path) -> None:
    """Writes features of texts as float16, under the encoder's name; the file appears whole or not at all."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.part")
    arrays = {text: np.ascontiguousarray(one, np.float16) for text, one in features.items()}
    temporary.write_bytes(safetensors.numpy.save(arrays, metadata={"encoder": encoder}))
    temporary.replace(path)


def load_prompts(path: str | Path, encoder: str) -> dict[str, np.ndarray]:
    """Text -> features; nothing if there is no such file, or if it is of another encoder."""
    if not Path(path).is_file():
        return {}
    with safetensors.safe_open(path, "numpy") as file:
        if (file.metadata() or {}).get("encoder") != encoder:
            return {}
        return {name: file.get_tensor(name).astype(np.float32) for name in file.keys()}
