"""What is known of a population of scenes after the scenes are gone; parts of it merge, and are kept in files."""

from __future__ import annotations

import dataclasses
import os
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from scjax.metrics.descriptors import Descriptor, describe
from scjax.metrics.detection import Detections
from scjax.metrics.tally import ClusterSums

_TALLY, _SHOWN = "tally/", "shown/"


@dataclasses.dataclass
class SceneStats:
    """Sums by location, and what has to be kept of every scene.

    Attributes:
      tally: sums by cluster; names start with "strict/", "compat/", "scene/", and "match/" where references were given.
      descriptors: raw, [scenes, .].
      clusters: of every scene.
      detections: of every scene with a reference, scored by distance to the ego.
      consensus: the same, scored by the agreement with other samples; empty where there are none.
      shown: name -> a value of every scene, by which the best and the worst are found; NaN where it has none.
    """

    tally: ClusterSums
    descriptors: Descriptor
    clusters: list[str]
    detections: list[Detections]
    consensus: list[Detections] = dataclasses.field(default_factory=list)
    shown: dict[str, Float64[np.ndarray, " scenes"]] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.clusters)

    def save(self, path: Path) -> None:
        """One npz file, under a temporary name first."""
        content: dict[str, Any] = {f"{_TALLY}{name}": value for name, value in self.tally.arrays().items()}
        content |= {f"{_SHOWN}{name}": value for name, value in self.shown.items()}
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
          ValueError: no such file, or one of another kind.
        """
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
                content = {name: data[name] for name in data.files}
            return cls(
                tally=ClusterSums.from_arrays(_under(content, _TALLY)),
                descriptors=Descriptor(*(content[name] for name in Descriptor._fields)),
                clusters=[str(name) for name in content["scene_clusters"]],
                detections=_unpacked("detections", content),
                consensus=_unpacked("consensus", content),
                shown=_under(content, _SHOWN),
            )
        except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise ValueError(f"{path} holds no measured scenes ({error}): delete it and evaluate again") from error


def merged(parts: Sequence[SceneStats]) -> SceneStats:
    """Parts of one population as a whole, scenes in the order of the parts."""
    tally = ClusterSums()
    for part in parts:
        tally.merge(part.tally)
    names = dict.fromkeys(name for part in parts for name in part.shown)
    return SceneStats(
        tally=tally,
        descriptors=stacked([describe([]), *(part.descriptors for part in parts)]),
        clusters=[cluster for part in parts for cluster in part.clusters],
        detections=[one for part in parts for one in part.detections],
        consensus=[one for part in parts for one in part.consensus],
        shown={name: np.concatenate([part.shown[name] for part in parts if len(part)]) for name in names},
    )


def stacked(rows: Sequence[Descriptor]) -> Descriptor:
    """Descriptors of several populations, one after the other."""
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
