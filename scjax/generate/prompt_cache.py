"""Token features of texts in a file of their own: prompts that ship with a model need no encoder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from scjax.nn.safetensors import sha256_of
from scjax.scene.files import write_file


def write_prompts(features: Mapping[str, np.ndarray], encoder: str, path: str | Path) -> None:
    """Writes features of texts as float16, under the encoder's name; the file appears whole or not at all."""
    arrays = {text: np.ascontiguousarray(one, np.float16) for text, one in features.items()}
    write_file(Path(path), lambda file: file.write(safetensors.numpy.save(arrays, metadata={"encoder": encoder})))


def load_prompts(path: str | Path, encoder: str, sha256: str = "") -> dict[str, np.ndarray]:
    """Text -> features; nothing if there is no such file, or if it is of another encoder.

    Args:
      sha256: of the file; "" if it is not known.

    Raises:
      ValueError: the file is damaged or, with a known hash, missing; names it.
    """
    path = Path(path)
    if not path.is_file():
        if sha256:
            raise ValueError(f"{path} is missing")
        return {}
    if sha256 and sha256_of(path) != sha256:
        raise ValueError(f"{path} is damaged (its sha256 is not the recorded one)")
    try:
        with safetensors.safe_open(path, "numpy") as file:
            if (file.metadata() or {}).get("encoder") != encoder:
                return {}
            return {name: file.get_tensor(name).astype(np.float32) for name in file.keys()}
    except Exception as error:  # the library raises many kinds for damaged bytes
        raise ValueError(f"{path} is damaged ({error})") from error
