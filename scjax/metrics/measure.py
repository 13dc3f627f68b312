"""Computes all metrics of scenes in one pass (``SceneStats``), and table values from the result.

Sums are pooled per location (``ClusterSums``); per scene only a descriptor (60 numbers) and the scored agents remain.
A set of any size is measured in parts, in any order, by any number of processes, and merged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from scjax.metrics.cluster_sums import ClusterSums
from scjax.metrics.control import ControlFrame
from scjax.metrics.descriptors import describe
from scjax.metrics.detection import average_precision, consensus, detections
from scjax.metrics.distributions import Sums, sums_by_mode, table
from scjax.metrics.placement import Region, match, match_summary
from scjax.metrics.pooling import Ratios, Values, ratio, singles
from scjax.metrics.realism import scene_realism
from scjax.metrics.scene_stats import SceneStats, concat_descriptors
from scjax.metrics.topology import Mode
from scjax.scene import AgentType, Crop, Scene

MODES: tuple[Mode, ...] = ("strict", "compat")
MATCHES: dict[str, dict[str, Any]] = {
    "match": {},
    "match_any_class": {"agnostic": True},
    "match_vehicles": {"types": (AgentType.VEHICLE,)},
}
"""Comparison -> options of ``placement.match``: which agents are matched."""

_TURNED = np.deg2rad(20)  # a larger ego heading means that the scene is not in the ego frame

ExtraRatios = Callable[[Scene, Scene | None], Ratios]
"""(scene, its reference) -> further ratios to pool."""


def measure(
    scenes: Iterable[Scene],
    clusters: Iterable[str],
    references: Iterable[Scene] | None = None,
    *,
    siblings: Iterable[Sequence[Scene]] | None = None,
    ego: bool = True,
    region: Region | None = None,
    extra_ratios: ExtraRatios | None = None,
) -> SceneStats:
    """Measures scenes one by one.

    Args:
      clusters: location of each scene.
      references: the scene whose condition each scene answers; None without references.
      siblings: for each scene, other samples of the same condition; their agreement scores its agents.
      ego: whether agent 0 of a scene is the ego.
      region: agents outside are not matched (``placement.field_of_view`` for image conditions).
      extra_ratios: further ratios, pooled as "extra/<name>".

    Raises:
      ValueError: the arguments differ in length.
    """
    reference_iter = None if references is None else singles(references)
    sibling_iter = None if siblings is None else iter(siblings)
    cluster_sums, rows, locations, per_scene = ClusterSums(), [describe([])], [], []
    by_distance, by_consensus = [], []
    for scene, cluster in zip(singles(scenes), clusters, strict=True):
        reference = None if reference_iter is None else _next_item(reference_iter, len(locations), "references")
        sums = _sums(scene, reference, ego, region)
        if extra_ratios is not None:
            sums |= {f"extra/{name}": np.array(pair) for name, pair in extra_ratios(scene, reference).items()}
        cluster_sums.add(sums, cluster)
        locations.append(cluster)
        rows.append(describe(scene, ego=ego))
        per_scene.append(_scene_values(sums))
        if reference is not None:
            options: dict = {"generated_ego": ego, "region": region}
            by_distance.append(detections(reference, scene, **options))
            if sibling_iter is not None:
                score = consensus(scene, _next_item(sibling_iter, len(locations) - 1, "lists of siblings"))
                by_consensus.append(detections(reference, scene, score, **options))
    columns = {name: np.array([one[name] for one in per_scene]) for name in (per_scene[0] if per_scene else {})}
    return SceneStats(cluster_sums, concat_descriptors(rows), locations, by_distance, by_consensus, columns)


def distribution_values(generated: Sums, real: Sums, mode: Mode) -> Values:
    """``distributions.table`` of the sums of ``measure``."""
    return table(_named(generated, f"{mode}/"), _named(real, f"{mode}/"))


def scene_values(sums: Sums) -> Values:
    """Means and shares of ``scene_realism``, over scenes, vehicles or lane connections.

    Also ego_away_m: distance of the ego from the origin [m], of centered scenes; ego_turned: share of egos whose
    heading differs from x by more than 20 degrees, as in scenes of another frame.
    """
    return {name: ratio(*map(float, pair)) for name, pair in _named(sums, "scene/").items()}


def match_values(sums: Sums, comparison: str = "match") -> Values:
    """M, P, PxR and their parts (``placement.match_summary``) for a comparison of ``MATCHES``."""
    pairs = _named(sums, f"{comparison}/").items()
    return match_summary({name: (float(pair[0]), float(pair[1])) for name, pair in pairs})


def extra_values(sums: Sums) -> Values:
    """Quotients of the ``extra_ratios``."""
    return {name: ratio(*map(float, pair)) for name, pair in _named(sums, "extra/").items()}


def precision_values(stats: SceneStats) -> Values:
    """Average precision, scored by distance to the ego and, with siblings, by their agreement."""
    results = {f"AP {name}": value for name, value in average_precision(stats.detections).items()}
    if stats.consensus:
        results |= {f"AP_consensus {name}": value for name, value in average_precision(stats.consensus).items()}
    return results


def control_values(
    stats: SceneStats, reference: SceneStats, *, seed: int = 0, shuffles: int = 10, pairs: int = 200_000
) -> Values:
    """CCS, SPG, CSC at the three levels; scene i of ``stats`` answers scene i of ``reference``.

    Raises:
      ValueError: the two differ in length, or one cluster holds more than half of the scenes.
    """
    if len(stats) != len(reference):
        raise ValueError(f"{len(stats)} scenes but {len(reference)} references: control compares them one to one")
    rng = np.random.default_rng(seed)
    frame = ControlFrame.of(reference.descriptors, reference.clusters, rng, shuffles=shuffles, pairs=pairs)
    return frame(stats.descriptors)


def _sums(scene: Scene, reference: Scene | None, ego: bool, region: Region | None) -> Sums:
    sums: Sums = {}
    for mode, results in sums_by_mode(scene, MODES).items():
        sums |= {f"{mode}/{name}": value for name, value in results.items()}
    ratios = scene_realism(scene, ego=ego)
    agents = np.asarray(scene.agents, np.float64)
    if ego and len(agents) and scene.crop == Crop.CENTERED:
        away, turned = np.linalg.norm(agents[0, :2]), np.abs(np.arctan2(agents[0, 5], agents[0, 4]))
        ratios["ego_away_m"] = float(away), 1.0
        ratios["ego_turned"] = float(turned > _TURNED), 1.0
    else:
        ratios |= dict.fromkeys(("ego_away_m", "ego_turned"), (0.0, 0.0))
    if reference is not None:
        if reference.crop != scene.crop:
            names = [Crop(int(one.crop)).name for one in (scene, reference)]
            raise ValueError(f"a {names[0]} scene has a {names[1]} reference: compare scenes of one window")
        for comparison, options in MATCHES.items():
            matched = match(reference, scene, generated_ego=ego, region=region, **options)
            sums |= {f"{comparison}/{name}": np.array(pair) for name, pair in matched.items()}
    return sums | {f"scene/{name}": np.array(pair) for name, pair in ratios.items()}


def _scene_values(sums: Sums) -> Values:
    """Values by which scenes are ranked in galleries."""
    results = {
        name: ratio(*map(float, sums[f"scene/{name}"]))
        for name in ("connection_gap_m", "vehicles_on_lane", "vehicle_overlap_pairs")
    }
    return results | ({"M": match_values(sums)["M"]} if "match/recall_1m" in sums else {})


def _next_item(items: Iterator[Any], number: int, what: str) -> Any:
    results = next(items, None)
    if results is None:
        raise ValueError(f"there are {number} {what} but more scenes: give one for each")
    return results


def _named(sums: Sums, prefix: str) -> Sums:
    return {name[len(prefix) :]: value for name, value in sums.items() if name.startswith(prefix)}
