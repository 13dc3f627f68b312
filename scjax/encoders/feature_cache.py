"""Features of pictures in a folder, computed once: many processes may read and write one folder.

An entry is named by the hash of all that its features depend on: the picture's content, the encoder with its weights
and precision, the preprocessing with its version. It is one safetensors file with a hash of its arrays, which appears
whole. A damaged entry counts as missing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from scjax.camera.photo import Photo
from scjax.encoders.depth import DEPTH_VERSION, DepthProvider, depth_tokens
from scjax.encoders.preprocessing import Preprocessing
from scjax.encoders.vision import GridTokens, ImageEncoder
from scjax.scene.files import write_file

_FORMAT = "1"
_ARRAYS = {"tokens", "mask", "grid"}


class FeatureCache:
    """Tokens of pictures in the files of a folder, float16."""

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)

    def path(self, key: str) -> Path:
        """The file of an entry."""
        return self.folder / key[:2] / f"{key}.safetensors"

    def __contains__(self, key: str) -> bool:
        """Whether there is a file of the entry, damaged or not."""
        return self.path(key).is_file()

    def read(self, key: str) -> GridTokens | None:
        """The tokens, in float32; None if they are missing or damaged."""
        try:
            with safetensors.safe_open(self.path(key), "numpy") as file:
                metadata = file.metadata() or {}
                arrays = {name: file.get_tensor(name) for name in file.keys()}
        except Exception:  # the library raises many kinds for damaged bytes
            return None
        if metadata.get("format") != _FORMAT or arrays.keys() != _ARRAYS or metadata.get("arrays") != _digest(arrays):
            return None
        rows, columns = arrays["grid"].tolist()
        return GridTokens(arrays["tokens"].astype(np.float32), arrays["mask"], (rows, columns))

    def write(self, key: str, tokens: GridTokens) -> None:
        """Keeps the tokens as float16; the file appears whole or not at all.

        Raises:
          ValueError: a number that float16 does not hold.
          OSError: the file cannot be written.
        """
        with np.errstate(over="ignore"):
            rounded = np.ascontiguousarray(tokens.tokens.astype(np.float16))
        if not np.isfinite(rounded).all():
            raise ValueError("features are above 65504: the weights of the encoder are damaged, or too large")
        arrays = {"tokens": rounded, "mask": np.ascontiguousarray(tokens.mask), "grid": np.array(tokens.grid, np.int32)}
        metadata = {"format": _FORMAT, "arrays": _digest(arrays)}
        data = safetensors.numpy.save(arrays, metadata=metadata)
        write_file(self.path(key), lambda file: file.write(data))

    def image_tokens(
        self, encoder: ImageEncoder, photos: Sequence[Photo], preprocessing: Preprocessing
    ) -> list[GridTokens]:
        """Features of every photo; those that are missing are computed, together, and kept."""
        keys = [image_key(encoder, photo, preprocessing) for photo in photos]
        return self._fill(keys, lambda missing: encoder([photos[index] for index in missing], preprocessing))

    def depth_tokens(
        self, provider: DepthProvider, photos: Sequence[Photo], preprocessing: Preprocessing
    ) -> list[GridTokens]:
        """Depth of every photo, likewise."""
        keys = [depth_key(provider, photo, preprocessing) for photo in photos]
        return self._fill(
            keys, lambda missing: depth_tokens(provider, [photos[index] for index in missing], preprocessing)
        )

    def _fill(self, keys: Sequence[str], compute: Callable[[Sequence[int]], Sequence[GridTokens]]) -> list[GridTokens]:
        tokens = [self.read(key) for key in keys]
        first = {key: index for index, key in reversed(list(enumerate(keys)))}  # equal photos are computed once
        missing = [index for index, key in enumerate(keys) if tokens[index] is None and first[key] == index]
        for index, result in zip(missing, compute(missing) if missing else (), strict=True):
            self.write(keys[index], result)
        return [self._rounded(key) if one is None else one for key, one in zip(keys, tokens, strict=True)]

    def _rounded(self, key: str) -> GridTokens:
        """What was written just now: the same numbers as in later calls."""
        tokens = self.read(key)
        if tokens is None:
            raise ValueError(f"{self.path(key)}: cannot be read again: another program changes the folder")
        return tokens


def image_key(encoder: ImageEncoder, photo: Photo, preprocessing: Preprocessing) -> str:
    """The entry of an encoder's features of a photo."""
    return _key("image", photo.content, encoder.key, preprocessing.key)


def depth_key(provider: DepthProvider, photo: Photo, preprocessing: Preprocessing) -> str:
    """The entry of a photo's depth."""
    return _key("depth", str(DEPTH_VERSION), photo.content, provider.key_of(photo), preprocessing.key)


def _key(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape} ".encode())
        digest.update(arrays[name].tobytes())
    return digest.hexdigest()
