"""What a report measures: populations of scenes -> rows of numbers, each with interval, counts and clusters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from tqdm import tqdm

from scjax.metrics import placement, reconstruction
from scjax.metrics.novelty import nearest_tiles
from scjax.metrics.pooling import Ratios, Values, intervals, pool, values
from scjax.metrics.realism import scene_realism
from scjax.scene import AgentType, Scene, validate

RANDOM_DRAWS = 10  # of the random placement, per tile
_COUNTED = {"M": "recall_1m", "P": "precision_1m", "PxR": "recall_1m", "link_f1_macro": "link_f1"}


@dataclasses.dataclass(frozen=True)
class Tiles:
    """Scenes and, for each, the location that it, or its request, comes from."""

    scenes: list[Scene]
    clusters: list[str]

    def __post_init__(self):
        if len(self.scenes) != len(self.clusters):
            raise ValueError(f"{len(self.scenes)} scenes but {len(self.clusters)} clusters")

    def __getitem__(self, rows: Sequence[int]) -> Tiles:
        return Tiles([self.scenes[row] for row in rows], [self.clusters[row] for row in rows])


@dataclasses.dataclass(frozen=True)
class Number:
    """A value with its 95 % interval over clusters; ``n`` counts what was averaged (None: scenes)."""

    value: float
    low: float
    high: float
    n: int | None
    scenes: int
    clusters: int


Row = dict[str, Number]


def row(ratios: Sequence[Ratios], clusters: Sequence[str], summarise: Callable[[Ratios], Values] = values) -> Row:
    """Pooled values of a population with cluster-bootstrap intervals."""
    total = pool(ratios)
    bounds = intervals(ratios, clusters, summarise)
    numbers = {}
    for name, value in summarise(total).items():
        n = round(total[_COUNTED.get(name, name)][1])
        numbers[name] = Number(value, *bounds[name], n, len(ratios), len(set(clusters)))
    return numbers


def reconstruction_row(real: Tiles, decoded: Sequence[Scene]) -> Row:
    """Errors of decoded twins, matched by index."""
    errors = [reconstruction.reconstruction_errors(*pair) for pair in zip(real.scenes, decoded, strict=True)]
    return row(errors, real.clusters, reconstruction.summarise)


def realism_row(tiles: Tiles, title: str) -> Row:
    """Faults that scenes show by themselves, and the share that breaks an invariant of the scene type."""
    ratios = [
        {**scene_realism(scene), "invalid_scenes": (float(invalid(scene)), 1.0)}
        for scene in _bar(tiles.scenes, f"realism of {title}")
    ]
    return row(ratios, tiles.clusters)


def placement_row(reference: Sequence[Scene], generated: Tiles) -> Row:
    """Matches with the reference scenes: of vehicles, of all classes; and overlaps and lane distances."""
    pairs = list(zip(reference, generated.scenes, strict=True))
    found: Row = {}
    for prefix, types in (("vehicle_", (AgentType.VEHICLE,)), ("", tuple(AgentType))):
        matches = [placement.match(*pair, types=types) for pair in pairs]
        matched = row(matches, generated.clusters, placement.summarise)
        found |= {f"{prefix}{name}": matched[name] for name in ("M", "P", "PxR")}
    kept = ("vehicles_on_lane", "off_heading", "vehicles_overlapping", "scenes_vehicle_overlap", "scenes_any_overlap")
    return found | {name: number for name, number in realism_row(generated, "placements").items() if name in kept}


def novelty_rows(populations: dict[str, Tiles], bank: Sequence[Scene], real: str) -> dict[str, Row]:
    """Nearest training tiles of every population, beside those of the held-back tiles ``populations[real]``.

    ``lane_distance_m``: mean distance to the tile with the nearest lanes; its 5th, 50th percentile; ``M``, ``P``: match
    with that tile; ``nearer_than_real_p05``: share of scenes nearer than the nearest 5 % of held-back tiles (expected:
    5 %, much more is copying).
    """
    nearest = {
        name: list(nearest_tiles(_bar(tiles.scenes, f"novelty of {name}"), bank)) for name, tiles in populations.items()
    }
    distances = {name: np.array([near.lane_distance for near in found]) for name, found in nearest.items()}
    threshold = float(np.quantile(distances[real], 0.05))
    rows = {}
    for name, found in nearest.items():
        ratios: list[Ratios] = [
            {
                **near.match,
                "lane_distance_m": (near.lane_distance, 1.0) if math.isfinite(near.lane_distance) else (0.0, 0.0),
                "nearer_than_real_p05": (float(near.lane_distance < threshold), 1.0),
            }
            for near in found
        ]
        clusters = populations[name].clusters
        numbers = row(ratios, clusters, placement.summarise)
        kept = {key: numbers[key] for key in ("lane_distance_m", "nearer_than_real_p05", "M", "P")}
        for share in (0.05, 0.5):
            value = float(np.quantile(distances[name], share))
            key = f"lane_distance_p{round(100 * share):02d}_m"
            kept[key] = Number(value, math.nan, math.nan, None, len(found), len(set(clusters)))
        rows[name] = kept
    return rows


def invalid(scene: Scene) -> bool:
    """Whether an invariant of the scene type is broken, by NaN for instance."""
    try:
        validate(scene)
    except ValueError:
        return True
    return False


def _bar(scenes: Sequence[Scene], title: str) -> Iterator[Scene]:
    """A progress bar, on a terminal."""
    yield from tqdm(scenes, desc=title, unit="scene", disable=None, leave=False)
