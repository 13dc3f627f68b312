"""Folders of features as ``scjax data embed-images`` writes them, with numbers that are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float32

from scjax.data.image_features import ImageEntry, ImageIndex
from scjax.encoders.feature_cache import FeatureCache
from scjax.encoders.vision import GridTokens

FEATURE_GRID, FEATURE_WIDTH = (4, 3), 5


def save_features(folder: Path, names: Sequence[str]) -> dict[str, Float32[np.ndarray, "cells width"]]:
    """Writes features of pictures whose numbers differ in size; the last cell cannot be read. Returns their tokens."""
    rng = np.random.default_rng(0)
    cells = FEATURE_GRID[0] * FEATURE_GRID[1]
    cache, entries, written = FeatureCache(folder / "features"), [], {}
    mask = np.arange(cells) < cells - 1
    for number, name in enumerate(names):
        tokens = rng.normal(3.0, [0.1, 1.0, 10.0, 5.0, 0.0], (cells, FEATURE_WIDTH)).astype(np.float32)
        written[name] = np.where(mask[:, None], tokens, 0).astype(np.float32)
        cache.write(f"{number:02d}key", GridTokens(written[name], mask, FEATURE_GRID))
        entries.append(ImageEntry(f"{name}.jpg", f"{number:02d}key", ""))
    index = ImageIndex(
        format=1,
        encoder="of a test",
        width=FEATURE_WIDTH,
        preprocessing="squash",
        grid=FEATURE_GRID,
        images=entries,
        skipped=[],
    )
    (folder / "images.json").write_bytes(msgspec.json.encode(index))
    return written
