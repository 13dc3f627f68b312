"""The corruption ladder: scenes that keep a known share of their reference, between another scene and a copy.

The rungs calibrate control metrics: a model is as good as the rung with the same value (metrics.md §4.3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.evaluate.hashing import content_hash
from scjax.evaluate.sources import SceneSource
from scjax.scene import Scene, stack, unpadded

LADDER = {"C1": (0.25, 0.15), "C2": (0.40, 0.30), "C3": (0.60, 0.45)}
"""Rung -> share of lanes and of agents that it keeps."""

NOISE = 1.0  # metres; standard deviation of the shift of every kept element, along x and y


class Corrupted:
    """Scenes that keep shares of ``reference``, slightly shifted; the other elements come from scenes of ``other``.

    The numbers of lanes and agents are those of the reference, if the other scene has enough. The ego is kept.
    """

    def __init__(self, reference: SceneSource, other: SceneSource, lanes: float, agents: float, seed: int = 0):
        if len(reference.clusters) != len(other.clusters):
            raise ValueError(f"{len(reference.clusters)} references but {len(other.clusters)} other scenes")
        self.reference, self.other, self.ego = reference, other, reference.ego
        self.lanes, self.agents, self.seed = lanes, agents, seed
        self.fingerprint = content_hash(
            "corrupted", reference.fingerprint, other.fingerprint, str(lanes), str(agents), str(seed)
        )

    @property
    def clusters(self) -> list[str]:
        return self.reference.clusters

    def read(self, rows: Sequence[int]) -> list[Scene]:
        scenes = []
        for row, reference, other in zip(rows, self.reference.read(rows), self.other.read(rows), strict=True):
            rng = np.random.default_rng([self.seed, int(row)])
            scenes.append(mix_scenes(reference, other, self.lanes, self.agents, rng))
        return scenes


def mix_scenes(reference: Scene, other: Scene, lanes: float, agents: float, rng: np.random.Generator) -> Scene:
    """Mixes two scenes: shares of the elements of ``reference``, shifted by about 1 m, then elements of ``other``."""
    pair = stack([reference, other]).to_numpy()
    own_lanes, more_lanes = _split(rng, len(reference.lane_mask), len(other.lane_mask), lanes)
    own_agents, more_agents = _split(
        rng, max(len(reference.agent_mask) - 1, 0), max(len(other.agent_mask) - 1, 0), agents
    )
    own_agents, more_agents = np.concatenate([[0], 1 + own_agents])[: len(reference.agent_mask)], 1 + more_agents
    fields = {}
    for name, value in pair.to_dict().items():
        if name == "links":
            size = len(own_lanes) + len(more_lanes)
            fields[name] = np.zeros((size, size), value.dtype)
            fields[name][: len(own_lanes), : len(own_lanes)] = value[0][np.ix_(own_lanes, own_lanes)]
            fields[name][len(own_lanes) :, len(own_lanes) :] = value[1][np.ix_(more_lanes, more_lanes)]
        elif name.startswith("lane") or name == "signals":
            fields[name] = np.concatenate([value[0][own_lanes], value[1][more_lanes]])
        elif name.startswith("agent"):
            fields[name] = np.concatenate([value[0][own_agents], value[1][more_agents]])
        else:
            fields[name] = value[0]
    fields["lanes"][: len(own_lanes), :, :2] += rng.normal(0, NOISE, (len(own_lanes), 1, 2))
    fields["agents"][1 : len(own_agents), :2] += rng.normal(0, NOISE, fields["agents"][1 : len(own_agents), :2].shape)
    return unpadded(reference.replace(**fields))


def _split(rng: np.random.Generator, own: int, other: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Random rows of either scene, together as many as the first has."""
    keep = round(share * own)
    return rng.permutation(own)[:keep], rng.permutation(other)[: own - keep]
