"""Statistics of a set of scenes: cluster sums, descriptors and scored agents; parts merge and are stored as npz
files."""

from __future__ import annotations

import dataclasses
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from scjax.metrics.cluster_sums import ClusterSums
from scjax.metrics.descriptors import Descriptor, describe
from scjax.metrics.detection import Detections

_SUMS, _PER_SCENE = "sums/", "per_scene/"


@dataclasses.dataclass
class SceneStats:
    """Sums per location, and the values of every scene that cannot be summed.

    Attributes:
      cluster_sums: sums per cluster; names start with "strict/", "compat/", "scene/", and with references "match/".
      descriptors: raw descriptors, [scenes, .].
      clusters: location of every scene.
      detections: of every scene with a reference, scored by distance to the ego.
      consensus: the same, scored by agreement with other samples; empty without siblings.
      per_scene: name -> value of every scene for ranking scenes; NaN where undefined.
    """

    cluster_sums: ClusterSums
    descriptors: Descriptor
    clusters: list[str]
    detections: list[Detections]
    consensus: list[Detections] = dataclasses.field(default_factory=list)
    per_scene: dict[str, Float64[np.ndarray, " scenes"]] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.clusters)

    def save(self, path: Path) -> None:
        """Writes one npz file (under a temporary name first)."""
        content: dict[str, Any] = {f"{_SUMS}{name}": value for name, value in self.cluster_sums.arrays().items()}
        content |= {f"{_PER_SCENE}{name}": value for name, value in self.per_scene.items()}
        content |= self.descriptors._asdict() | {"scene_clusters": np.array(self.clusters, dtype=np.str_)}
        for name in ("detections", "consensus"):
            content |= _packed(name, getattr(self, name))
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        with temporary.open("wb") as file:
            np.savez_compressed(file, **content)
        temporary.replace(path)

    @classmethod
    def load(cls, path: Path) -> SceneStats:
        """Inverse of ``save``.

        Raises:
          ValueError: the file is missing, damaged or of another format.
        """
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
                content = {name: data[name] for name in data.files}
            return cls(
                cluster_sums=ClusterSums.from_arrays(_under(content, _SUMS)),
                descriptors=Descriptor(*(content[name] for name in Descriptor._fields)),
                clusters=[str(name) for name in content["scene_clusters"]],
                detections=_unpacked("detections", content),
                consensus=_unpacked("consensus", content),
                per_scene=_under(content, _PER_SCENE),
            )
        except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise ValueError(f"{path} holds no measured scenes ({error}): delete it and evaluate again") from error


def merge_stats(parts: Sequence[SceneStats]) -> SceneStats:
    """Joins parts of one set of scenes, in the order of the parts."""
    cluster_sums = ClusterSums()
    for part in parts:
        cluster_sums.merge(part.cluster_sums)
    names = dict.fromkeys(name for part in parts for name in part.per_scene)
    return SceneStats(
        cluster_sums=cluster_sums,
        descriptors=concat_descriptors([describe([]), *(part.descriptors for part in parts)]),
        clusters=[cluster for part in parts for cluster in part.clusters],
        detections=[one for part in parts for one in part.detections],
        consensus=[one for part in parts for one in part.consensus],
        per_scene={name: np.concatenate([part.per_scene[name] for part in parts if len(part)]) for name in names},
    )


def concat_descriptors(rows: Sequence[Descriptor]) -> Descriptor:
    """Concatenates descriptors along the scene axis."""
    return Descriptor(*(np.concatenate([row[k] for row in rows]) for k in range(len(Descriptor._fields))))


def _packed(name: str, scenes: list[Detections]) -> dict[str, np.ndarray]:
    """Ragged lists as flat arrays and lengths."""
    if not scenes:
        return {}
    return {
        f"{name}_lengths": np.array([len(one.score) for one in scenes]),
        f"{name}_score": np.concatenate([one.score for one in scenes]),
        f"{name}_hit": np.concatenate([one.hit for one in scenes]),
        f"{name}_references": np.array([one.references for one in scenes]),
    }


def _unpacked(name: str, content: dict[str, np.ndarray]) -> list[Detections]:
    if f"{name}_lengths" not in content:
        return []
    ends = np.cumsum(content[f"{name}_lengths"])[:-1]
    parts = (np.split(content[f"{name}_{field}"], ends) for field in ("score", "hit"))
    return [
        Detections(score, hit, int(references))
        for score, hit, references in zip(*parts, content[f"{name}_references"], strict=True)
    ]


def _under(content: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name[len(prefix) :]: value for name, value in content.items() if name.startswith(prefix)}
