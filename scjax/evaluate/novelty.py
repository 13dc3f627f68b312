"""Tables of novelty (distance from the training scenes) and diversity (samples of one condition)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from tqdm import tqdm

from scjax.data.loader import LoaderConfig
from scjax.evaluate.eval_tiles import EvaluationTiles
from scjax.evaluate.hashing import content_hash
from scjax.evaluate.population import Population
from scjax.evaluate.sources import NpzScenes, RecordScenes, SceneSource
from scjax.evaluate.tables import Number, Row, Section
from scjax.metrics.novelty import Nearest, lane_distance, nearest_tiles
from scjax.metrics.placement import THRESHOLDS, match_rate, match_summary
from scjax.metrics.pooling import Ratios, intervals, pool
from scjax.scene import Scene

_COPIED = 0.5  # F1 of the match with the nearest tile: above, the scene is a copy
_COLUMNS = ("lane_distance_m", "M", "P", "copied")

NOTE = (
    "Nearest training scene by lanes: symmetric mean Chamfer distance [m] of lane points every 2 m, including "
    "direction "
    "(opposite directions are 4 m apart). aligned: the scene may move by up to 4 m and 15 degrees, since "
    "training moves "
    "scenes too. M, P: match of the agents with those of that scene; copied: share of scenes in which most "
    "agents match. "
    "Reference points: held-out real scenes are novel, jittered training scenes are memorized. Lane distance "
    "alone does "
    "not separate them: straight roads are near each other."
)
DIVERSITY_NOTE = (
    "Two samples of the same condition: mean lane distance [m], and share of agents that do not match (1 - M). 0 means "
    "that the condition determines the scene, or that all samples are equal."
)


class JitteredTrainingScenes:
    """Random training scenes with the jitter of training: what a model generates that only memorizes."""

    ego = True

    def __init__(self, records: RecordScenes, count: int, seed: int = 0):
        number = len(records.clusters)
        self.records, self.seed = records, seed
        self.rows = np.random.default_rng(seed).permutation(number)[:count].tolist()
        self.clusters = [records.clusters[row] for row in self.rows]
        self.fingerprint = content_hash("jittered", records.fingerprint, str(seed), str(count))

    def read(self, rows: Sequence[int]) -> list[Scene]:
        scenes, jitter = [], LoaderConfig()
        for row in rows:
            rng = np.random.default_rng([self.seed, int(row)])
            dx, dy = rng.uniform(-1, 1, 2) * jitter.jitter_position
            turn = float(np.deg2rad(rng.uniform(-1, 1) * jitter.jitter_heading))
            scenes.append(self.records.read_moved(self.rows[int(row)], float(dx), float(dy), turn))
        return scenes


def novelty_section(populations: Sequence[Population], retrieval_set: SceneSource, most: int) -> Section:
    """Novelty of each population and of jittered training scenes.

    Args:
      populations: methods and real scenes.
      retrieval_set: the training scenes.
      most: number of scenes per population, evenly spaced.
    """
    if isinstance(retrieval_set, RecordScenes):
        populations = [
            *populations,
            Population("training scenes, jittered", JitteredTrainingScenes(retrieval_set, most)),
        ]
    tiles = retrieval_set.read(range(len(retrieval_set.clusters)))
    table_rows = {}
    for population in populations:
        rows = _evenly_spaced(len(population), most)
        clusters = [population.clusters(row, row + 1)[0] for row in rows]
        pairs = nearest_tiles(population.source.read(rows), tiles)
        nearest = list(tqdm(pairs, f"novelty of {population.name}", len(rows), mininterval=1.0))
        numbers = {}
        for prefix, side in (("", 0), ("aligned ", 1)):
            ratios = [_ratios(pair[side]) for pair in nearest]
            values, bounds = match_summary(pool(ratios)), intervals(ratios, clusters, match_summary)
            numbers |= {f"{prefix}{name}": Number(values[name], *bounds[name]) for name in _COLUMNS}
        table_rows[population.name] = Row(numbers, len(rows), len(set(clusters)))
    return Section("Novelty", NOTE, table_rows)


def diversity_section(populations: Sequence[Population], most: int) -> Section:
    """Differences between two samples of a condition, for populations with siblings; ``most``: scenes per
    population."""
    table_rows = {}
    for population in populations:
        if not population.siblings:
            continue
        rows = _evenly_spaced(len(population), most)
        firsts, seconds = (source.read(rows) for source in (population.source, population.siblings[0]))
        pairs = list(zip(firsts, seconds, strict=True))
        numbers = {
            "lane distance m": _mean([lane_distance(*pair) for pair in pairs]),
            "agents that differ": _mean([1 - match_rate(*pair) for pair in pairs]),
        }
        clusters = population.clusters(0, len(population))
        table_rows[population.name] = Row(numbers, len(rows), len({clusters[row] for row in rows}))
    return Section("Diversity", DIVERSITY_NOTE, table_rows)


def _ratios(near: Nearest) -> Ratios:
    agents = near.match["recall_1m"][1] + near.match["precision_1m"][1]
    hits = np.mean([near.match[f"recall_{metres:g}m"][0] for metres in THRESHOLDS])
    finite = math.isfinite(near.lane_distance)
    return {
        **near.match,
        "lane_distance_m": (near.lane_distance, 1.0) if finite else (0.0, 0.0),
        "copied": (float(2 * hits / max(agents, 1.0) > _COPIED), float(agents > 0)),
    }


def _mean(values: Sequence[float]) -> Number:
    finite = [value for value in values if math.isfinite(value)]
    return Number(float(np.mean(finite)) if finite else math.nan)


def _evenly_spaced(count: int, most: int) -> list[int]:
    return sorted({round(row) for row in np.linspace(0, count - 1, min(count, most))})


def with_stored_scenes(populations: Mapping[str, Population]) -> list[Population]:
    """Populations with scenes of their own; those that only repeat rows of the retrieval set are left out."""
    stored = (NpzScenes, EvaluationTiles, RecordScenes)
    return [one for one in populations.values() if len(one) and isinstance(one.source, stored)]
