"""All metrics of scenes in one pass (``SceneStats``), and the values of the tables from what it leaves.

Sums are pooled by location (``ClusterSums``); kept are a descriptor (60 numbers) and the scored agents. A population of any
size is measured in parts, in any order, by any number of processes, and merged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from scjax.metrics.control import ControlFrame
from scjax.metrics.descriptors import describe
from scjax.metrics.detection import average_precision, consensus, detections
from scjax.metrics.distributions import Sums, sums_by_mode, table
from scjax.metrics.measured import SceneStats, stacked
from scjax.metrics.placement import Where, match, summarise
from scjax.metrics.pooling import Ratios, Values, ratio, singles
from scjax.metrics.realism import scene_realism
from scjax.metrics.tally import ClusterSums
from scjax.metrics.topology import Mode
from scjax.scene import AgentType, Crop, Scene

MODES: tuple[Mode, ...] = ("strict", "compat")
MATCHES: dict[str, dict[str, Any]] = {
    "match": {},
    "match_any_class": {"agnostic": True},
    "match_vehicles": {"types": (AgentType.VEHICLE,)},
}
"""Which agents are matched with which: options of ``placement.match``."""

_TURNED = np.deg2rad(20)  # heading of an ego in a frame that does not look along x


Also = Callable[[Scene, Scene | None], Ratios]
"""(scene, its reference) -> more ratios to sum up."""


def measure(
    scenes: Iterable[Scene],
    clusters: Iterable[str],
    references: Iterable[Scene] | None = None,
    *,
    siblings: Iterable[Sequence[Scene]] | None = None,
    ego: bool = True,
    where: Where | None = None,
    also: Also | None = None,
) -> SceneStats:
    """Measures single scenes in turn.

    Args:
      clusters: location of each scene.
      references: for each scene, the one that its condition came from; None if there is none.
      siblings: for each scene, other samples of its condition, whose agreement scores its agents.
      ego: whether agent 0 of a scene is the ego.
      where: agents elsewhere are not matched (``placement.cone`` for scenes made from an image).
      also: summed up as "also/<name>".

    Raises:
      ValueError: if the four differ in length.
    """
    twins = None if references is None else singles(references)
    others = None if siblings is None else iter(siblings)
    tally, rows, places, shown = ClusterSums(), [describe([])], [], []
    by_distance, by_consensus = [], []
    for scene, cluster in zip(singles(scenes), clusters, strict=True):
        reference = None if twins is None else _following(twins, len(places), "references")
        sums = _sums(scene, reference, ego, where)
        if also is not None:
            sums |= {f"also/{name}": np.array(pair) for name, pair in also(scene, reference).items()}
        tally.add(sums, cluster)
        places.append(cluster)
        rows.append(describe(scene, ego=ego))
        shown.append(_shown(sums))
        if reference is not None:
            options: dict = {"generated_ego": ego, "where": where}
            by_distance.append(detections(reference, scene, **options))
            if others is not None:
                score = consensus(scene, _following(others, len(places) - 1, "lists of siblings"))
                by_consensus.append(detections(reference, scene, score, **options))
    columns = {name: np.array([one[name] for one in shown]) for name in (shown[0] if shown else {})}
    return SceneStats(tally, stacked(rows), places, by_distance, by_consensus, columns)


def distribution_values(generated: Sums, real: Sums, mode: Mode) -> Values:
    """``distributions.table`` of sums made by ``measure``."""
    return table(_named(generated, f"{mode}/"), _named(real, f"{mode}/"))


def scene_values(sums: Sums) -> Values:
    """Shares and means over scenes, vehicles or joints of what scenes show by themselves (``scene_realism``).

    Also ego_away_m: distance of the ego from the origin of centred scenes; ego_turned: share that look another way
    than along x, as scenes in another frame do.
    """
    return {name: ratio(*map(float, pair)) for name, pair in _named(sums, "scene/").items()}


def match_values(sums: Sums, kind: str = "match") -> Values:
    """M, P, PxR and their parts (``placement.summarise``) of one of the kinds of ``MATCHES``."""
    pairs = _named(sums, f"{kind}/").items()
    return summarise({name: (float(pair[0]), float(pair[1])) for name, pair in pairs})


def also_values(sums: Sums) -> Values:
    """Quotients of the ratios that ``also`` gave."""
    return {name: ratio(*map(float, pair)) for name, pair in _named(sums, "also/").items()}


def precision_values(measured: SceneStats) -> Values:
    """Average precision, scored by the distance to the ego and, where samples have siblings, by their agreement."""
    found = {f"AP {name}": value for name, value in average_precision(measured.detections).items()}
    if measured.consensus:
        found |= {f"AP_consensus {name}": value for name, value in average_precision(measured.consensus).items()}
    return found


def control_values(
    measured: SceneStats, reference: SceneStats, *, seed: int = 0, shuffles: int = 10, pairs: int = 200_000
) -> Values:
    """CCS, SPG, CSC at the three levels; scene i of ``measured`` was made for scene i of ``reference``.

    Raises:
      ValueError: if the two differ in length, or one cluster holds more than half of the scenes.
    """
    if len(measured) != len(reference):
        raise ValueError(f"{len(measured)} scenes but {len(reference)} references: control compares them one to one")
    rng = np.random.default_rng(seed)
    frame = ControlFrame.of(reference.descriptors, reference.clusters, rng, shuffles=shuffles, pairs=pairs)
    return frame(measured.descriptors)


def _sums(scene: Scene, reference: Scene | None, ego: bool, where: Where | None) -> Sums:
    sums: Sums = {}
    for mode, found in sums_by_mode(scene, MODES).items():
        sums |= {f"{mode}/{name}": value for name, value in found.items()}
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
        for kind, options in MATCHES.items():
            matched = match(reference, scene, generated_ego=ego, where=where, **options)
            sums |= {f"{kind}/{name}": np.array(pair) for name, pair in matched.items()}
    return sums | {f"scene/{name}": np.array(pair) for name, pair in ratios.items()}


def _shown(sums: Sums) -> Values:
    """What makes one scene worse or better than another."""
    found = {
        name: ratio(*map(float, sums[f"scene/{name}"]))
        for name in ("connection_gap_m", "vehicles_on_lane", "vehicle_overlap_pairs")
    }
    return found | ({"M": match_values(sums)["M"]} if "match/recall_1m" in sums else {})


def _following(items: Iterator[Any], number: int, what: str) -> Any:
    found = next(items, None)
    if found is None:
        raise ValueError(f"there are {number} {what} but more scenes: give one for each")
    return found


def _named(sums: Sums, prefix: str) -> Sums:
    return {name[len(prefix) :]: value for name, value in sums.items() if name.startswith(prefix)}
