"""The corruption ladder: scenes that keep a known share of their reference, between another scene (U) and a copy.

What control metrics say of a rung tells what they say of a model (metrics.md §4.3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.evaluate.sources import Source, digest
from scjax.scene import Scene, stack, unpadded

LADDER = {"C1": (0.25, 0.15), "C2": (0.40, 0.30), "C3": (0.60, 0.45)}
"""Shares of lanes and of agents that a rung keeps."""

NOISE = 1.0  # metres, of every element kept, along x and along y


class Corrupted:
    """Scenes of ``reference`` of which only shares are kept, a little moved; the rest comes from scenes of ``other``.

    There are as many lanes and agents as in the reference, as far as the other scene holds enough; the ego is kept.
    """

    def __init__(self, reference: Source, other: Source, lanes: float, agents: float, seed: int = 0):
        if len(reference.clusters) != len(other.clusters):
            raise ValueError(f"{len(reference.clusters)} references but {len(other.clusters)} other scenes")
        self.reference, self.other, self.ego = reference, other, reference.ego
        self.lanes, self.agents, self.seed = lanes, agents, seed
        self.fingerprint = digest(
            "corrupted", reference.fingerprint, other.fingerprint, str(lanes), str(agents), str(seed)
        )

    @property
    def clusters(self) -> list[str]:
        return self.reference.clusters

    def read(self, rows: Sequence[int]) -> list[Scene]:
        made = []
        for row, kept, other in zip(rows, self.reference.read(rows), self.other.read(rows), strict=True):
            rng = np.random.default_rng([self.seed, int(row)])
            made.append(mixed(kept, other, self.lanes, self.agents, rng))
        return made


def mixed(kept: Scene, other: Scene, lanes: float, agents: float, rng: np.random.Generator) -> Scene:
    """One scene of both: shares of the elements of ``kept``, moved by 1 m, and then elements of ``other``."""
    pair = stack([kept, other]).to_numpy()
    own_lanes, more_lanes = _split(rng, len(kept.lane_mask), len(other.lane_mask), lanes)
    own_agents, more_agents = _split(rng, max(len(kept.agent_mask) - 1, 0), max(len(other.agent_mask) - 1, 0), agents)
    own_agents, more_agents = np.concatenate([[0], 1 + own_agents])[: len(kept.agent_mask)], 1 + more_agents
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
    return unpadded(kept.replace(**fields))


def _split(rng: np.random.Generator, own: int, other: int, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Random rows of the one and of the other that make up as many as the one has."""
    keep = round(share * own)
    return rng.permutation(own)[:keep], rng.permutation(other)[: own - keep]
