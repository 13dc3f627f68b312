"""Tiles in the ragged format of the project's evaluation sets."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scjax.evaluate.hashing import content_hash
from scjax.scene import Link, Scene, empty


class EvaluationTiles:
    """A source of evaluation tiles; ``variant``: which agents they have, "main" or "all"."""

    def __init__(self, path: str, variant: str = "main"):
        self.path, self.variant = Path(path), variant
        if not self.path.is_file():
            raise ValueError(f"tiles:{path}: there is no such file")
        if variant not in ("main", "all"):
            raise ValueError(f"tiles:{path}#{variant}: write main or all behind the #")
        try:
            names = self._arrays["cluster_name"][self._arrays["tile_cluster"]]
            self.ego = bool((self._arrays["tile_object"] >= 0).all())
        except KeyError as error:
            raise ValueError(f"tiles:{path} lacks the array {error}: it holds no evaluation tiles") from error
        self.clusters = [str(name) for name in names]
        self.fingerprint = content_hash("tiles", hashlib.sha256(self.path.read_bytes()).hexdigest(), variant)

    @functools.cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        with self.path.open("rb") as file, np.load(file) as data:
            return dict(data)

    def read(self, rows: Sequence[int]) -> list[Scene]:
        return [tile_scene(self._arrays, int(k), self.variant) for k in rows]

    def __getstate__(self):
        return {name: value for name, value in vars(self).items() if name != "_arrays"}


def tile_scene(arrays: dict[str, np.ndarray], tile: int, variant: str) -> Scene:
    """One tile as a scene; unknown heights are 1.5 m with ``agent_known`` False."""
    rows, lanes, edges = (
        np.arange(*arrays[f"{element}_offsets"][tile : tile + 2]) for element in ("agent", "lane", "edge")
    )
    rows = rows[arrays[f"agent_{variant}"][rows]]
    points = np.concatenate([arrays["lanes_xy"][lanes], arrays["lanes_z"][lanes][..., None]], -1)
    blank = empty(len(rows), len(lanes))
    before, after = arrays["edges"][edges].T.astype(int)
    links = np.diag(np.full(len(lanes), Link.SELF, np.int32))
    links[after, before] = Link.SUCCESSOR
    links[before, after] = Link.PREDECESSOR
    return blank.replace(
        links=links,
        agents=np.nan_to_num(arrays["agents"][rows], nan=1.5),
        agent_types=arrays["agent_type"][rows].astype(np.int32),
        agent_mask=np.ones(len(rows), bool),
        agent_known=~np.isnan(arrays["agents"][rows]),
        lanes=np.nan_to_num(points),
        lane_mask=np.ones(len(lanes), bool),
        lane_known=~np.isnan(points).any(1),
    )
