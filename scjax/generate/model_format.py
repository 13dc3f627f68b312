"""Model folders of older formats, brought up to the names of today."""

from __future__ import annotations

from typing import Any

import numpy as np

FORMAT = 2

# Format 1 -> 2: names only; every array stays bit for bit what it was.
_PARTS = {"representation": "codec", "counter": "count_predictor", "steering": "energy_guidance"}
_DENOISER = {
    "control": "cross_attention",
    "layouts": "crops",
    "given_embedding": "known_embedding",
    "waves": "fourier_features",
    "hints": "relative_geometry",
}
_ARRAYS = {
    "counter": {"given_lanes": "known_lanes"},
    "denoiser": {
        "lane_waves": "lane_fourier",
        "agent_waves": "agent_fourier",
        "lane_given": "lane_known",
        "agent_given": "agent_known",
        "hints": "relative_geometry",
        "anchors": "position_heads",
    },
}


def upgrade(description: dict[str, Any], arrays: dict[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The contents of a model folder of any older format in the names of ``FORMAT``.

    Args:
      description: what ``model.json`` holds.
      arrays: dotted parameter path -> array.
    """
    if description.get("format", 0) >= FORMAT:
        return description, arrays
    description = {_PARTS.get(name, name): value for name, value in description.items()}
    if description.get("denoiser"):
        description["denoiser"] = {_DENOISER.get(name, name): value for name, value in description["denoiser"].items()}
    return {**description, "format": FORMAT}, {_upgrade_path(path): array for path, array in arrays.items()}


def _upgrade_path(path: str) -> str:
    part, *rest = path.split(".")
    if rest:
        rest[0] = _ARRAYS.get(part, {}).get(rest[0], rest[0])
    return ".".join([_PARTS.get(part, part), *rest])
