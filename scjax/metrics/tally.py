"""Sums of many scenes, kept by location cluster: small however many scenes there are, and all that tables need.

Scenes of one location are alike, so intervals and floors draw whole clusters. Scenes without a known location are
dealt out to a fixed number of groups.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from jaxtyping import Float64

from scjax.metrics.distributions import Sums
from scjax.metrics.pooling import Values, interval

FORMAT = 1
GROUPS = 200  # of scenes whose location is unknown
DRAWS = 300

Table = Callable[[Sums, Sums], Values]
"""(sums of the generated, sums of the real scenes) -> values."""


@dataclasses.dataclass
class ClusterSums:
    """Cluster -> sums of its scenes."""

    clusters: dict[str, Sums] = dataclasses.field(default_factory=dict)

    def add(self, sums: Sums, cluster: str) -> None:
        """One scene, or the sums of several of one cluster."""
        held = self.clusters.get(cluster)
        self.clusters[cluster] = (
            dict(sums) if held is None else {name: held[name] + value for name, value in sums.items()}
        )

    def merge(self, other: ClusterSums) -> None:
        """Adds what another tally holds; the order does not matter."""
        for cluster, sums in other.clusters.items():
            self.add(sums, cluster)

    @property
    def total(self) -> Sums:
        """Sums over everything; empty without any scene."""
        return self._split(self._matrix().sum(0)) if self.clusters else {}

    def arrays(self) -> dict[str, np.ndarray]:
        """All of it as arrays, to be kept in a file."""
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
          ValueError: of another format.
        """
        if (found := int(content["format"])) != FORMAT:
            raise ValueError(f"a tally of format {found} instead of {FORMAT}")
        sums = {key[4:]: value for key, value in content.items() if key.startswith("sum/")}
        names = [str(name) for name in content["clusters"]]
        return cls({cluster: {name: rows[k] for name, rows in sums.items()} for k, cluster in enumerate(names)})

    def intervals(
        self, real: ClusterSums, table: Table, *, draws: int = DRAWS, seed: int = 0, level: float = 0.95
    ) -> dict[str, tuple[float, float]]:
        """Bootstrap intervals of ``table(total, real.total)``, clusters of both sides drawn with replacement.

        Drawing makes two sides differ more than they do, so that distances would be too large: the percentile interval
        is moved by that bias, and distances are kept from going below 0. NaN with fewer than two clusters on a side.
        """
        centre, drawn = table(self.total, real.total), self.drawn(real, table, draws=draws, seed=seed)
        return bounds(centre, drawn, level)

    def drawn(
        self, real: ClusterSums, table: Table, *, draws: int = DRAWS, seed: int = 0
    ) -> dict[str, Float64[np.ndarray, " draws"]]:
        """The values in every draw of ``intervals``; empty with fewer than two clusters on a side.

        Tallies of the same clusters in the same order draw the same ones from the same seed, so that differences of
        their values are paired.
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
        """What the table says of two random sets of other locations of these: mean, and the range of 95 % of the draws.

        A model cannot be told from real scenes where its value lies within the range. Each set holds clusters until
        there are ``scenes`` of them, or half of all clusters.

        Raises:
          ValueError: with fewer than two clusters.
        """
        names = list(self.clusters)
        if len(names) < 2:
            raise ValueError(f"a floor needs scenes of two locations or more, not {len(names)}")
        held = np.array([_scene_count(sums) for sums in self.clusters.values()])
        wanted = min(scenes or np.inf, held.sum() / 2)
        rng, matrix, rows = np.random.default_rng(seed), self._matrix(), []
        for _ in range(splits):
            order = rng.permutation(len(names))
            reached = np.cumsum(held[order])
            first = min(int(np.searchsorted(reached, wanted)) + 1, len(names) - 1)
            second = int(np.searchsorted(reached, reached[first - 1] + wanted)) + 1
            sides = order[:first], order[first : max(second, first + 1)]
            rows.append(table(*(self._split(matrix[side].sum(0)) for side in sides)))
        found = {}
        for name in rows[0]:
            column = np.array([row[name] for row in rows])
            column = column[np.isfinite(column)]
            found[name] = (float(column.mean()) if len(column) else float("nan"), *interval(column))
        return found

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


def bounds(
    centre: Values, drawn: Mapping[str, Float64[np.ndarray, " draws"]], level: float = 0.95
) -> dict[str, tuple[float, float]]:
    """``ClusterSums.intervals`` of values whose draws are at hand; NaN without any."""
    tails = [(1 - level) / 2, (1 + level) / 2]
    found = {}
    for name, value in centre.items():
        column = drawn.get(name, np.zeros(0))
        column = column[np.isfinite(column)]
        if not len(column) or not np.isfinite(value):
            found[name] = (float("nan"), float("nan"))
            continue
        bias = column.mean() - value if _is_distance(name) else 0.0
        low, high = np.quantile(column, tails) - bias
        found[name] = (float(max(low, 0.0) if _is_distance(name) else low), float(high))
    return found


def group_of(index: int) -> str:
    """The group that scene ``index`` of unknown location is dealt to."""
    return f"group {index % GROUPS}"


def _scene_count(sums: Sums) -> float:
    """Number of scenes that sums of either mode hold; 1 a cluster where they are not counted."""
    counts = (float(value[0]) for name, value in sums.items() if name.rpartition("/")[2] == "scenes")
    return next(counts, 1.0)


def _is_distance(name: str) -> bool:
    return name.startswith("frechet_") or name.endswith("_jsd")
