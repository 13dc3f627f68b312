"""All metrics of scenes in one pass: what a scene adds to sums, and what has to be kept of it one by one.

Sums are pooled by location (``Tally``); kept are a descriptor (60 numbers) and the scored agents. A population of any
size is measured in parts, in any order, by any number of processes, and merged.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from scjax.metrics.boxes import intersection_areas
from scjax.metrics.control import ControlFrame
from scjax.metrics.descriptors import Descriptor, describe
from scjax.metrics.detection import Detections, average_precision, detections
from scjax.metrics.distributions import Sums, scene_sums, table
from scjax.metrics.placement import match, summarise
from scjax.metrics.pooling import Values, ratio, singles
from scjax.metrics.realism import overlapping_pairs, scene_realism
from scjax.metrics.tally import Tally
from scjax.metrics.topology import Mode
from scjax.scene import Scene

MODES: tuple[Mode, ...] = ("strict", "compat")
_OVERLAPS = (0.01, 0.1)  # intersection over union


@dataclasses.dataclass
class Measured:
    """What is known of a population after its scenes are gone.

    Attributes:
      tally: sums by cluster; names start with "strict/", "compat/", "scene/", and "match/" where references were given.
      descriptors: raw, [scenes, .].
      clusters: of every scene.
      detections: of every scene with a reference.
    """

    tally: Tally
    descriptors: Descriptor
    clusters: list[str]
    detections: list[Detections]

    def __len__(self) -> int:
        return len(self.clusters)


def measure(
    scenes: Iterable[Scene],
    clusters: Iterable[str],
    references: Iterable[Scene] | None = None,
    *,
    ego: bool = True,
) -> Measured:
    """Measures single scenes in turn.

    Args:
      clusters: location of each scene.
      references: for each scene, the one that its condition came from; None if there is none.
      ego: whether agent 0 of a scene is the ego.

    Raises:
      ValueError: if the three differ in length.
    """
    made = Measured(Tally(), describe([]), [], [])
    rows: list[Descriptor] = []
    twins = iter(references) if references is not None else None
    for scene, cluster in zip(singles(scenes), clusters, strict=True):
        reference = None
        if twins is not None:
            reference = next(twins, None)
            if reference is None:
                raise ValueError(f"there are {len(rows)} references but more scenes: give one for each")
            made.detections.append(detections(reference, scene, generated_ego=ego))
        made.tally.add(_sums(scene, reference, ego), cluster)
        made.clusters.append(cluster)
        rows.append(describe(scene, ego=ego))
    made.descriptors = _stacked([made.descriptors, *rows])
    return made


def merged(parts: Sequence[Measured]) -> Measured:
    """Parts of one population as a whole, scenes in the order of the parts."""
    tally = Tally()
    for part in parts:
        tally.merge(part.tally)
    return Measured(
        tally=tally,
        descriptors=_stacked([part.descriptors for part in parts]),
        clusters=[cluster for part in parts for cluster in part.clusters],
        detections=[one for part in parts for one in part.detections],
    )


def distribution_values(generated: Sums, real: Sums, mode: Mode) -> Values:
    """``distributions.table`` of sums made by ``measure``."""
    return table(_named(generated, f"{mode}/"), _named(real, f"{mode}/"))


def scene_values(sums: Sums) -> Values:
    """Shares and means over scenes, vehicles or joints of what scenes show by themselves (``scene_realism``)."""
    return {name: ratio(*map(float, pair)) for name, pair in _named(sums, "scene/").items()}


def match_values(sums: Sums) -> Values:
    """M, P, PxR and their parts (``placement.summarise``)."""
    return summarise({name: (float(pair[0]), float(pair[1])) for name, pair in _named(sums, "match/").items()})


def precision_values(measured: Measured) -> Values:
    """Average precision with the distance to the ego as score."""
    return {f"AP {name}": value for name, value in average_precision(measured.detections).items()}


def control_values(
    measured: Measured, reference: Measured, *, seed: int = 0, shuffles: int = 10, pairs: int = 200_000
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


def _sums(scene: Scene, reference: Scene | None, ego: bool) -> Sums:
    sums: Sums = {}
    for mode in MODES:
        sums |= {f"{mode}/{name}": value for name, value in scene_sums(scene, mode).items()}
    ratios = scene_realism(scene, ego=ego)
    pairs = overlapping_pairs(scene, ego=ego)
    agents = np.asarray(scene.agents, np.float64)
    area = intersection_areas(agents[pairs[:, 0]], agents[pairs[:, 1]])
    size = agents[:, 6] * agents[:, 7]
    union = np.maximum(size[pairs].sum(1) - area, 1e-9)
    ratios |= {f"scenes_overlap_iou_{least:g}": (float((area / union > least).any()), 1.0) for least in _OVERLAPS}
    sums |= {f"scene/{name}": np.array(pair) for name, pair in ratios.items()}
    if reference is not None:
        sums |= {
            f"match/{name}": np.array(pair) for name, pair in match(reference, scene, generated_ego=ego).items()
        }  # fmt: skip
    return sums


def _named(sums: Sums, prefix: str) -> Sums:
    return {name[len(prefix) :]: value for name, value in sums.items() if name.startswith(prefix)}


def _stacked(rows: Sequence[Descriptor]) -> Descriptor:
    return Descriptor(*(np.concatenate([row[k] for row in rows]) for k in range(3)))
