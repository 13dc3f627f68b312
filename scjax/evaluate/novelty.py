"""How far scenes are from the training scenes, and samples of one condition from each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from tqdm import tqdm

from scjax.data.loader import PipelineConfig
from scjax.evaluate.population import Population
from scjax.evaluate.sources import EvaluationTiles, Npz, Records, Source, digest
from scjax.evaluate.tables import Number, Row, Section
from scjax.metrics import placement
from scjax.metrics.novelty import Nearest, lane_distance, nearest_tiles
from scjax.metrics.placement import match_rate
from scjax.metrics.pooling import Ratios, intervals, pool
from scjax.scene import Scene

_COPIED = 0.5  # F1 of the match with the nearest tile's agents from which a scene repeats that tile
_KEPT = ("lane_distance_m", "M", "P", "copied")

NOTE = (
    "Nearest training scene by lanes: symmetric mean Chamfer distance [m] of lane points every 2 m, direction included "
    "(opposite directions are 4 m apart); aligned: the scene may move by up to 4 m and 15 degrees onto it, since "
    "training moves scenes too. M, P: match of the agents with that scene's; copied: share of scenes where most agents "
    "match. Held-back real scenes are as new as can be: a model that scores like them does not memorise, one that "
    "scores like the moved training scenes does. Lane distance alone cannot tell: straight roads are near each other."
)
DIVERSITY_NOTE = (
    "Samples of one condition against each other: mean lane distance [m], and the share of agents that do not match "
    "(1 - M). 0 means that the condition decides everything, or that samples are all the same."
)


class Moved:
    """Training scenes at random, moved as training moves them: what a model that only memorises would make."""

    ego = True

    def __init__(self, records: Records, count: int, seed: int = 0):
        number = len(records.clusters)
        self.records, self.seed = records, seed
        self.rows = np.random.default_rng(seed).permutation(number)[:count].tolist()
        self.clusters = [records.clusters[row] for row in self.rows]
        self.fingerprint = digest("moved", records.fingerprint, str(seed), str(count))

    def read(self, rows: Sequence[int]) -> list[Scene]:
        made, jitter = [], PipelineConfig()
        for row in rows:
            rng = np.random.default_rng([self.seed, int(row)])
            dx, dy = rng.uniform(-1, 1, 2) * jitter.jitter_position
            turn = float(np.deg2rad(rng.uniform(-1, 1) * jitter.jitter_heading))
            made.append(self.records.read_moved(self.rows[int(row)], float(dx), float(dy), turn))
        return made


def novelty_section(populations: Sequence[Population], bank: Source, most: int) -> Section:
    """Of at most ``most`` scenes of every population, spread over it, and of training scenes that were only moved."""
    if isinstance(bank, Records):
        populations = [*populations, Population("training scenes, moved", Moved(bank, most))]
    tiles = bank.read(range(len(bank.clusters)))
    rows = {}
    for population in populations:
        chosen = _spread(len(population), most)
        scenes = population.source.read(chosen)
        clusters = population.clusters(0, len(population))
        bar = tqdm(nearest_tiles(scenes, tiles), f"novelty of {population.name}", len(scenes), mininterval=1.0)
        found, numbers = list(bar), {}
        places = [clusters[row] for row in chosen]
        for prefix, side in (("", 0), ("aligned ", 1)):
            ratios = [_ratios(pair[side]) for pair in found]
            values, bounds = placement.match_summary(pool(ratios)), intervals(ratios, places, placement.match_summary)
            numbers |= {f"{prefix}{name}": Number(values[name], *bounds[name]) for name in _KEPT}
        rows[population.name] = Row(numbers, len(chosen), len(set(places)))
    return Section("Novelty", NOTE, rows)


def diversity_section(populations: Sequence[Population], most: int) -> Section | None:
    """Of populations whose conditions were answered more than once; None if there is none."""
    rows = {}
    for population in populations:
        if not population.siblings:
            continue
        chosen = _spread(len(population), most)
        firsts, seconds = (source.read(chosen) for source in (population.source, population.siblings[0]))
        pairs = list(zip(firsts, seconds, strict=True))
        numbers = {
            "lane distance m": _mean([lane_distance(*pair) for pair in pairs]),
            "agents that differ": _mean([1 - match_rate(*pair) for pair in pairs]),
        }
        clusters = population.clusters(0, len(population))
        rows[population.name] = Row(numbers, len(chosen), len({clusters[row] for row in chosen}))
    return Section("Diversity", DIVERSITY_NOTE, rows) if rows else None


def _ratios(near: Nearest) -> Ratios:
    agents = near.match["recall_1m"][1] + near.match["precision_1m"][1]
    hits = np.mean([near.match[f"recall_{metres:g}m"][0] for metres in placement.THRESHOLDS])
    finite = math.isfinite(near.lane_distance)
    return {
        **near.match,
        "lane_distance_m": (near.lane_distance, 1.0) if finite else (0.0, 0.0),
        "copied": (float(2 * hits / max(agents, 1.0) > _COPIED), float(agents > 0)),
    }


def _mean(values: Sequence[float]) -> Number:
    finite = [value for value in values if math.isfinite(value)]
    return Number(float(np.mean(finite)) if finite else math.nan)


def _spread(count: int, most: int) -> list[int]:
    return sorted({round(row) for row in np.linspace(0, count - 1, min(count, most))})


def of_interest(populations: Mapping[str, Population]) -> list[Population]:
    """Rows that hold scenes, and not the bank's own."""
    own = (Npz, EvaluationTiles, Records)
    return [one for one in populations.values() if len(one) and isinstance(one.source, own)]
