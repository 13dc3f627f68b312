"""The baseline of traffic on given lanes: vehicles at random along them, as many as there are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scjax.evaluate.sources import Source, digest
from scjax.metrics.placement import random_lane_aligned, vehicle_pool
from scjax.scene import Scene

_POOL = 500  # scenes of the bank whose vehicles lend speed and size


class LaneAligned:
    """The reference's lanes and ego with vehicles placed anew; a scene that has no lane keeps its ego only."""

    def __init__(self, reference: Source, bank: Source, seed: int = 0):
        self.reference, self.seed, self.ego = reference, seed, True
        number = len(bank.clusters)
        rows = np.random.default_rng(seed).permutation(number)[:_POOL]
        self._vehicles = vehicle_pool(bank.read(rows.tolist()))
        self.fingerprint = digest("lane-aligned", reference.fingerprint, bank.fingerprint, str(seed))

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
