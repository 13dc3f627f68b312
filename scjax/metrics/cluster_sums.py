"""Sums over scenes, one set per location cluster: all that the tables, intervals and floors need.

Scenes of one location are alike, so bootstrap intervals and floors resample whole clusters. Scenes without a known
location are distributed over a fixed number of groups. The size does not grow with the number of scenes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from jaxtyping import Float64

from scjax.metrics.distributions import Sums
from scjax.metrics.pooling import Values, interval

FORMAT = 1
GROUPS = 200  # for scenes of unknown location
DRAWS = 300  # bootstrap samples

Table = Callable[[Sums, Sums], Values]
"""(sums of the generated, sums of the real scenes) -> values."""


@dataclasses.dataclass
class ClusterSums:
    """Cluster -> sums of its scenes."""

    clusters: dict[str, Sums] = dataclasses.field(default_factory=dict)

    def add(self, sums: Sums, cluster: str) -> None:
        """Adds the sums of one scene, or of several scenes of one cluster."""
        previous = self.clusters.get(cluster)
        self.clusters[cluster] = (
            dict(sums) if previous is None else {name: previous[name] + value for name, value in sums.items()}
        )

    def merge(self, other: ClusterSums) -> None:
        """Adds the sums of ``other``; the order of merging does not matter."""
        for cluster, sums in other.clusters.items():
            self.add(sums, cluster)

    @property
    def total(self) -> Sums:
        """Sums over all clusters; empty without scenes."""
        return self._split(self._matrix().sum(0)) if self.clusters else {}

    def arrays(self) -> dict[str, np.ndarray]:
        """The content as arrays for an npz file."""
        names = sorted(self.clusters)
        content = {"format": np.array(FORMAT), "clusters": np.array(names, dtype=np.str_)}
        if names:
            content |= {
                f"sum/{name}": np.stack([self.clusters[cluster][name] for cluster in names])
                for name in self.clusters[names[0]]
            }
        return content

    @classmethod
    def from_arrays(cls, content: Mapping[str, np.ndarray]) -> ClusterSums:
        """Inverse of ``arrays``.

        Raises:
          ValueError: the arrays have another format.
        """
        if (number := int(content["format"])) != FORMAT:
            raise ValueError(f"cluster sums of format {number} instead of {FORMAT}")
        sums = {key[4:]: value for key, value in content.items() if key.startswith("sum/")}
        names = [str(name) for name in content["clusters"]]
        return cls({cluster: {name: rows[k] for name, rows in sums.items()} for k, cluster in enumerate(names)})

    def intervals(
        self, real: ClusterSums, table: Table, *, draws: int = DRAWS, seed: int = 0, level: float = 0.95
    ) -> dict[str, tuple[float, float]]:
        """Bootstrap intervals of ``table(total, real.total)``; both sides resample clusters with replacement.

        Resampling increases the distance between two sides. The percentile interval of a distance is shifted by that
        bias and clipped at 0. NaN with fewer than two clusters on a side.
        """
        samples = self.bootstrap_samples(real, table, draws=draws, seed=seed)
        return bootstrap_intervals(table(self.total, real.total), samples, level)

    def bootstrap_samples(
        self, real: ClusterSums, table: Table, *, draws: int = DRAWS, seed: int = 0
    ) -> dict[str, Float64[np.ndarray, " draws"]]:
        """Name -> its value in each bootstrap sample; empty with fewer than two clusters on a side.

        Objects with the same clusters in the same order and the same seed resample the same clusters, so differences
        of their values are paired.
        """
        if min(len(self.clusters), len(real.clusters)) < 2:
            return {}
        rng = np.random.default_rng(seed)
        sides = [side._weighted(rng, draws) for side in (self, real)]
        rows = [table(*pair) for pair in zip(*sides, strict=True)]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def floor(
        self, table: Table, *, scenes: int | None = None, splits: int = DRAWS, seed: int = 0
    ) -> dict[str, tuple[float, float, float]]:
        """Floor: the table between two random sets of disjoint clusters of these; mean and central 95 % over splits.

        A value inside the range is not significantly different from real scenes. Clusters are added to each set until
        it has ``scenes`` scenes, or half of all scenes.

        Raises:
          ValueError: there are fewer than two clusters.
        """
        names = list(self.clusters)
        if len(names) < 2:
            raise ValueError(f"a floor needs scenes of two locations or more, not {len(names)}")
        scene_counts = np.array([_scene_count(sums) for sums in self.clusters.values()])
        target = min(scenes or np.inf, scene_counts.sum() / 2)
        rng, matrix, rows = np.random.default_rng(seed), self._matrix(), []
        for _ in range(splits):
            order = rng.permutation(len(names))
            cumulative = np.cumsum(scene_counts[order])
            first = min(int(np.searchsorted(cumulative, target)) + 1, len(names) - 1)
            second = int(np.searchsorted(cumulative, cumulative[first - 1] + target)) + 1
            sides = order[:first], order[first : max(second, first + 1)]
            rows.append(table(*(self._split(matrix[side].sum(0)) for side in sides)))
        ranges = {}
        for name in rows[0]:
            column = np.array([row[name] for row in rows])
            column = column[np.isfinite(column)]
            ranges[name] = (float(column.mean()) if len(column) else float("nan"), *interval(column))
        return ranges

    def _matrix(self) -> Float64[np.ndarray, "clusters numbers"]:
        names = list(next(iter(self.clusters.values())))
        return np.stack([np.concatenate([np.ravel(sums[name]) for name in names]) for sums in self.clusters.values()])

    def _split(self, flat: np.ndarray) -> Sums:
        shapes = {name: np.shape(value) for name, value in next(iter(self.clusters.values())).items()}
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])
        parts = np.split(flat, ends[:-1])
        return {name: part.reshape(shape) for (name, shape), part in zip(shapes.items(), parts, strict=True)}

    def _weighted(self, rng: np.random.Generator, draws: int) -> Iterable[Sums]:
        number = len(self.clusters)
        weights = rng.multinomial(number, np.full(number, 1 / number), draws)
        return [self._split(row) for row in weights @ self._matrix()]


def bootstrap_intervals(
    point: Values, samples: Mapping[str, Float64[np.ndarray, " draws"]], level: float = 0.95
) -> dict[str, tuple[float, float]]:
    """Intervals as ``ClusterSums.intervals`` from given bootstrap samples; NaN without samples.

    Args:
      point: the values over all scenes.
      samples: of ``ClusterSums.bootstrap_samples``.
      level: coverage.
    """
    tails = [(1 - level) / 2, (1 + level) / 2]
    bounds = {}
    for name, value in point.items():
        column = samples.get(name, np.zeros(0))
        column = column[np.isfinite(column)]
        if not len(column) or not np.isfinite(value):
            bounds[name] = (float("nan"), float("nan"))
            continue
        bias = column.mean() - value if _is_distance(name) else 0.0
        low, high = np.quantile(column, tails) - bias
        bounds[name] = (float(max(low, 0.0) if _is_distance(name) else low), float(high))
    return bounds


def group_of(index: int) -> str:
    """The group that stands for the location of scene ``index``, if that is unknown."""
    return f"group {index % GROUPS}"


def _scene_count(sums: Sums) -> float:
    """Number of scenes in the sums; 1 where they do not count scenes."""
    counts = (float(value[0]) for name, value in sums.items() if name.rpartition("/")[2] == "scenes")
    return next(counts, 1.0)


def _is_distance(name: str) -> bool:
    return name.startswith("frechet_") or name.endswith("_jsd")
