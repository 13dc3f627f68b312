"""Scenes of the parity set as NormalizedScene: one at a time, or padded together with garbage in the padding."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scjax.models.autoencoder import AutoencoderConfig
from scjax.models.codec import NormalizedScene
from scjax.scene.per_type import PerType


def load(folder: Path, name: str) -> dict[str, np.ndarray]:
    """The arrays of one file; skips where it is absent."""
    file = folder / name
    if not file.is_file():
        pytest.skip(f"the parity set in {folder} has no {name}")
    with np.load(file) as arrays:
        return dict(arrays)


def autoencoder_config(folder: Path) -> AutoencoderConfig:
    """Sizes of the set."""
    file = folder / "config.json"
    if not file.is_file():
        pytest.skip(f"the parity set in {folder} has no config.json")
    sizes = json.loads(file.read_text())["autoencoder"]
    renamed = {"point_dim": "point_dims", "connection_types": "link_types"}
    return AutoencoderConfig(**{renamed.get(name, name): n for name, n in sizes.items() if name != "max_agents"})


def scene_names(inputs: dict[str, np.ndarray]) -> list[str]:
    """s0, s1, ..."""
    return sorted({name.split("/")[0] for name in inputs}, key=lambda name: int(name[1:]))


def tokens_of(inputs: dict[str, np.ndarray], scene: str) -> NormalizedScene:
    """One scene, [1, ...]."""
    s = {name.split("/", 1)[1]: value for name, value in inputs.items() if name.startswith(f"{scene}/")}
    partitioned = int(s["scene_type"]) == 1
    agents, lanes = s["agent_states"], s["lane_points"]
    single = {
        "agents": agents,
        "agent_types": s["agent_types"],
        "agent_mask": np.ones(len(agents), bool),
        "agent_known": np.ones(agents.shape, bool),
        "agent_behind": partitioned & (agents[:, 0] <= 0),
        "lanes": lanes,
        "lane_types": s["lane_types"],
        "lane_type_known": np.ones(len(lanes), bool),
        "lane_mask": np.ones(len(lanes), bool),
        "lane_known": np.ones((len(lanes), lanes.shape[-1]), bool),
        "lane_behind": s["lane_partition_mask"],
        "links": s["lane_connections"],
        "crop": s["scene_type"].astype(np.int32),
        "domain": s["map_id"].astype(np.int32),
    }
    return NormalizedScene(**{name: value[None] for name, value in single.items()})


def nodes_of(inputs: dict[str, np.ndarray], scene: str, name: str) -> PerType:
    """``{name}_agent`` and ``{name}_lane``, [1, ...]."""
    return PerType(agents=inputs[f"{scene}/{name}_agent"][None], lanes=inputs[f"{scene}/{name}_lane"][None])


_AGENT_FIELDS = ("agents", "agent_types", "agent_mask", "agent_known", "agent_behind")
_LANE_FIELDS = ("lanes", "lane_types", "lane_type_known", "lane_mask", "lane_known", "lane_behind")


def padded(tokens: NormalizedScene, agents: int, lanes: int, garbage: float | None = None) -> NormalizedScene:
    """``tokens`` [B, ...] grown to these sizes; ``garbage`` fills float padding, and classes with nonsense."""
    fields = {name: getattr(tokens, name) for name in tokens.__dataclass_fields__}
    for name in _AGENT_FIELDS + _LANE_FIELDS:
        fields[name] = _grow(fields[name], 1, agents if name in _AGENT_FIELDS else lanes, garbage, name)
    fields["links"] = _grow(_grow(fields["links"], 1, lanes, garbage, "links"), 2, lanes, garbage, "links")
    return NormalizedScene(**fields)


def padded_nodes(nodes: PerType, agents: int, lanes: int, garbage: float | None = None) -> PerType:
    """The same for latents and noise."""
    return PerType(
        agents=_grow(nodes.agents, 1, agents, garbage, "z"), lanes=_grow(nodes.lanes, 1, lanes, garbage, "z")
    )


def concatenate(*trees):
    """Batches side by side."""
    if isinstance(trees[0], (NormalizedScene, PerType)):
        names = trees[0].__dataclass_fields__
        return type(trees[0])(**{name: np.concatenate([getattr(tree, name) for tree in trees]) for name in names})
    raise TypeError(f"cannot concatenate {type(trees[0])}")


def _grow(array: np.ndarray, axis: int, size: int, garbage: float | None, name: str) -> np.ndarray:
    shape = list(array.shape)
    shape[axis] = size - shape[axis]
    if garbage is None or name.endswith("mask"):
        fill = np.zeros(shape, array.dtype)
    elif array.dtype == bool:
        fill = np.ones(shape, bool)
    elif np.issubdtype(array.dtype, np.integer):
        fill = np.full(shape, 77, array.dtype)
    else:
        fill = np.full(shape, garbage, array.dtype)
    return np.concatenate([array, fill], axis)
