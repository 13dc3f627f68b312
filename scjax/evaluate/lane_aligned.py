"""The random lane-aligned baseline: as many vehicles as in the reference, at random on its lanes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.evaluate.hashing import content_hash
from scjax.evaluate.sources import SceneSource
from scjax.metrics.placement import random_lane_aligned, vehicle_pool
from scjax.scene import Scene

_POOL = 500  # scenes of the retrieval set whose vehicles give speeds and sizes


class LaneAligned:
    """Lanes and ego of the reference with randomly placed vehicles; a scene without lanes keeps only its ego."""

    def __init__(self, reference: SceneSource, retrieval_set: SceneSource, seed: int = 0):
        self.reference, self.seed, self.ego = reference, seed, True
        number = len(retrieval_set.clusters)
        rows = np.random.default_rng(seed).permutation(number)[:_POOL]
        self._vehicles = vehicle_pool(retrieval_set.read(rows.tolist()))
        self.fingerprint = content_hash("lane-aligned", reference.fingerprint, retrieval_set.fingerprint, str(seed))

    @property
    def clusters(self) -> list[str]:
        return self.reference.clusters

    def read(self, rows: Sequence[int]) -> list[Scene]:
        return [
            random_lane_aligned(np.random.default_rng([self.seed, int(row)]), scene, self._vehicles)
            if len(scene.lane_mask)
            else scene.replace(**{name: getattr(scene, name)[:1] for name in _AGENTS})
            for row, scene in zip(rows, self.reference.read(rows), strict=True)
        ]


_AGENTS = ("agents", "agent_types", "agent_mask", "agent_known")
