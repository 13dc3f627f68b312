"""What a report measures: populations of scenes -> rows of numbers, each with interval, counts and clusters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from tqdm import tqdm

from scjax.metrics import placement, reconstruction
from scjax.metrics.novelty import Nearest, nearest_tiles
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


def novelty_rows(populations: dict[str, Tiles], bank: Sequence[Scene]) -> dict[str, Row]:
    """Nearest training tiles of every population.

    lane_distance_m: mean distance to the tile with the nearest lanes, and its 5th and 50th percentile; M, P: match of
    the scene's agents with that tile's; copied: share of scenes whose agents mostly are that tile's; aligned_...: the
    same when the scene may move a little to fit the tile, as training moves tiles.
    """
    rows: dict[str, Row] = {}
    for name, tiles in populations.items():
        found = list(nearest_tiles(_bar(tiles.scenes, f"novelty of {name}"), bank))
        rows[name] = {}
        for prefix, ones in (("", [plain for plain, _ in found]), ("aligned_", [aligned for _, aligned in found])):
            numbers = row([_novelty_ratios(one) for one in ones], tiles.clusters, placement.summarise)
            kept = {key: numbers[key] for key in ("lane_distance_m", "M", "P", "copied")}
            for share in (0.05, 0.5):
                value = float(np.quantile([one.lane_distance for one in ones], share))
                key = f"lane_distance_p{round(100 * share):02d}_m"
                kept[key] = Number(value, math.nan, math.nan, None, len(ones), len(set(tiles.clusters)))
            rows[name] |= {f"{prefix}{key}": number for key, number in kept.items()}
    return rows


def _novelty_ratios(near: Nearest) -> Ratios:
    """Also whether agents agree: F1 of the match, averaged over the thresholds, above 1/2; scenes of agents only."""
    agents = near.match["recall_1m"][1] + near.match["precision_1m"][1]
    agreement = np.mean([2 * near.match[f"recall_{m:g}m"][0] for m in placement.THRESHOLDS]) / max(agents, 1.0)
    finite = math.isfinite(near.lane_distance)
    return {
        **near.match,
        "lane_distance_m": (near.lane_distance, 1.0) if finite else (0.0, 0.0),
        "copied": (float(agreement > 0.5), float(agents > 0)),
    }


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
