"""Synthetic worlds as a source of records: ``build(Worlds(seed, count), out)``."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np

from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.sources import BuildOptions, Loaded, Scanned
from scjax.data.synthetic import domains
from scjax.data.synthetic.labels import label
from scjax.data.synthetic.world import VERSION, make_world, object_of, raw_scene
from scjax.data.tiles import pose_of


@dataclasses.dataclass(frozen=True)
class Worlds:
    """Worlds 0 .. ``count`` - 1 of ``seed``; each is a location of its own. Poses come from the worlds, all standard.

    Raises:
      ValueError: if ``count`` is less than 1 or ``seed`` negative.
    """

    seed: int
    count: int

    def __post_init__(self):
        if self.count < 1 or self.seed < 0:
            raise ValueError(
                f"count is {self.count} and seed {self.seed}: give at least one world, a seed of 0 or more"
            )

    def names(self) -> list[str]:
        """``seed/k`` of every world."""
        return [f"{self.seed}/{k:07d}" for k in range(self.count)]

    def scan(self, name: str) -> Scanned:
        """Domain of the world, without making it."""
        seed, k = (int(part) for part in name.split("/"))
        domain = domains.draw(np.random.default_rng([VERSION, seed, k])).name
        digest = hashlib.sha256(f"synthetic world {VERSION} {name}".encode()).hexdigest()
        return Scanned(name, digest, domain, name)

    def load(self, item: Scanned, options: BuildOptions, dense: bool) -> Loaded:
        """Makes the world; the options do not matter to it."""
        del options, dense
        seed, k = (int(part) for part in item.file.split("/"))
        world = make_world(seed, k)
        raw = raw_scene(world)
        graph = build_graph(raw)
        index = index_segments(graph)
        poses = [pose_of(raw, index, ego.moment, object_of(world, ego.moment, ego.agent)) for ego in world.egos]
        labels = [label(world, ego).to_json() for ego in world.egos]
        return Loaded(raw, graph, index, poses, len(poses), labels, keep_parked=True)
