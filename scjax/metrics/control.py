"""Does a sample follow its condition? Cosine of paired descriptors (CCS), its gain over shuffled pairs (SPG), and the
agreement of distances between scenes (CSC); metrics.md §4.2.

Sample i was made from a condition that came from reference i. All take standardised descriptors of one level.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Sequence

import numpy as np
from jaxtyping import Float64, Int
from scipy.stats import rankdata

from scjax.metrics.descriptors import LEVELS, Descriptor, Standard
from scjax.metrics.pooling import Values, interval

_FEW = 3000  # scenes

Vectors = Float64[np.ndarray, "scenes features"]


@dataclasses.dataclass(frozen=True)
class ControlFrame:
    """What populations made for the same references are compared by: one standard, the same shuffles and pairs."""

    standard: Standard
    reference: Descriptor
    shuffles: Int[np.ndarray, "shuffles scenes"]
    pairs: Int[np.ndarray, "pairs 2"]

    @classmethod
    def of(
        cls, raw: Descriptor, clusters: Sequence[Hashable], rng: np.random.Generator, *, shuffles: int = 10,
        pairs: int = 200_000,
    ) -> ControlFrame:  # fmt: skip
        """From the raw descriptors of the references and their location clusters.

        Args:
          shuffles: 0 draws none, and SPG is NaN.

        Raises:
          ValueError: no reference, or, with shuffles, a cluster of more than half of them.
        """
        standard = Standard.of(raw)
        drawn = derangements(clusters, rng, shuffles) if shuffles else np.zeros((0, len(clusters)), int)
        return cls(standard, standard(raw), drawn, scene_pairs(clusters, rng, pairs))

    def __call__(self, raw: Descriptor) -> Values:
        """CCS, SPG and CSC at the three levels; scene i of ``raw`` was made for reference i."""
        ours, found = self.standard(raw), {}
        for level in LEVELS:
            x, y = getattr(self.reference, level), getattr(ours, level)
            found[f"{level} CCS"] = ccs(x, y)
            found[f"{level} SPG"] = spg(x, y, self.shuffles)
            found[f"{level} CSC"] = csc(x, y, self.pairs)
        return found

    def intervals(
        self, raw: Descriptor, clusters: Sequence[Hashable], *, draws: int = 200, seed: int = 0, level: float = 0.95
    ) -> dict[str, tuple[float, float]]:
        """Bootstrap intervals of the values, drawing whole location clusters (not pairs) with replacement.

        Shuffles and pairs stay as they are, a scene or a pair counts as often as its clusters were drawn. NaN with
        fewer than two clusters.
        """
        drawn = self.drawn(raw, clusters, draws=draws, seed=seed)
        if not drawn:
            return dict.fromkeys(self(raw), (float("nan"), float("nan")))
        return {name: interval(values, level) for name, values in drawn.items()}

    def drawn(
        self, raw: Descriptor, clusters: Sequence[Hashable], *, draws: int = 200, seed: int = 0
    ) -> dict[str, Float64[np.ndarray, " draws"]]:
        """The values in every draw of ``intervals``; empty with fewer than two clusters.

        Equal clusters and seeds draw the same locations, so that differences of two populations' values are paired.
        """
        label = np.unique(np.array([str(cluster) for cluster in clusters]), return_inverse=True)[1]
        number = int(label.max(initial=-1)) + 1
        if number < 2:
            return {}
        weights = np.random.default_rng(seed).multinomial(number, np.full(number, 1 / number), draws)
        weights = weights[:, label].astype(np.float64)
        i, j = self.pairs.T
        ours, found = self.standard(raw), {}
        for name in LEVELS:
            x, y = getattr(self.reference, name), getattr(ours, name)
            paired = cosines(x, y)
            gain = paired - np.mean([cosines(x[row], y) for row in self.shuffles] or [np.full(len(x), np.nan)], axis=0)
            apart = _distances(x, self.pairs), _distances(y, self.pairs)
            found[f"{name} CCS"] = weights @ paired / weights.sum(1)
            found[f"{name} SPG"] = weights @ gain / weights.sum(1)
            found[f"{name} CSC"] = np.array([_correlation(*apart, row[i] * row[j]) for row in weights])
        return found


def ccs(reference: Vectors, sample: Vectors) -> float:
    """Mean cosine of reference i with sample i."""
    return float(cosines(reference, sample).mean()) if len(reference) else float("nan")


def spg(reference: Vectors, sample: Vectors, shuffles: Int[np.ndarray, "shuffles scenes"]) -> float:
    """CCS less the mean cosine with shuffled references (``derangements``)."""
    shuffled = [ccs(reference[shuffle], sample) for shuffle in shuffles]
    return ccs(reference, sample) - float(np.mean(shuffled)) if shuffled else float("nan")


def csc(reference: Vectors, sample: Vectors, pairs: Int[np.ndarray, "pairs 2"], *, ranks: bool = False) -> float:
    """Correlation, over pairs of scenes, of the distance of the references with the distance of the samples.

    Distance is one less the cosine. Pearson, or Spearman over ``ranks``. NaN where either side does not vary.
    """
    ours, theirs = _distances(sample, pairs), _distances(reference, pairs)
    if len(pairs) < 2 or not ours.std() or not theirs.std():
        return float("nan")
    if ranks:
        ours, theirs = rankdata(ours), rankdata(theirs)
    return float(np.corrcoef(theirs, ours)[0, 1])


def _correlation(first: np.ndarray, second: np.ndarray, weight: np.ndarray) -> float:
    """Weighted Pearson correlation; NaN where either side does not vary."""
    total = weight.sum()
    if not total:
        return float("nan")
    one, two = first - weight @ first / total, second - weight @ second / total
    spread = np.sqrt((weight @ one**2) * (weight @ two**2))
    return float(weight @ (one * two) / spread) if spread > 0 else float("nan")


def _distances(vectors: Vectors, pairs: np.ndarray) -> np.ndarray:
    """One less the cosine. Few scenes: from one product of all with all, as the golden rank correlations were computed
    (scenes that occur twice make ties that rounding breaks, in an order that differs between processors)."""
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
    i, j = pairs.T
    return 1 - ((unit @ unit.T)[i, j] if len(unit) <= _FEW else (unit[i] * unit[j]).sum(-1))


def cosines(first: Vectors, second: Vectors) -> Float64[np.ndarray, " scenes"]:
    """Row by row; zero where either vector is zero."""
    norms = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    return (first * second).sum(-1) / np.where(norms > 0, norms, 1.0)


def derangements(
    clusters: Sequence[Hashable], rng: np.random.Generator, count: int = 10
) -> Int[np.ndarray, "shuffles scenes"]:
    """Permutations that move every scene to one of another cluster.

    Raises:
      ValueError: if one cluster holds more than half of the scenes, so that there is none.
    """
    label = np.unique(np.array([str(cluster) for cluster in clusters]), return_inverse=True)[1]
    number = len(label)
    largest = int(np.bincount(label).max()) if number else 0
    if not number or 2 * largest > number:
        raise ValueError(
            f"{largest} of {number} scenes share a location cluster: shuffling moves each scene to another cluster, "
            "so none may hold more than half of the scenes"
        )
    # Scenes in blocks of their cluster, moved on by at least the largest block, never meet their own.
    made = np.empty((count, number), int)
    for row in made:
        names = rng.permutation(label.max() + 1)
        order = np.lexsort((rng.random(number), names[label]))
        row[order] = np.roll(order, int(rng.integers(largest, number - largest + 1)))
    return _mixed(made, label, rng)


def _mixed(shuffles: np.ndarray, label: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random exchanges that keep every scene away from its cluster: the block shift alone would not be random."""
    number = len(label)
    for row in shuffles:
        for i, j in rng.integers(number, size=(4 * number, 2)):
            if label[i] != label[row[j]] and label[j] != label[row[i]]:
                row[i], row[j] = row[j], row[i]
    return shuffles


def scene_pairs(
    clusters: Sequence[Hashable], rng: np.random.Generator, most: int = 200_000
) -> Int[np.ndarray, "pairs 2"]:
    """Pairs i < j of scenes of different clusters: all of them, or ``most`` at random."""
    label = np.unique(np.array([str(cluster) for cluster in clusters]), return_inverse=True)[1]
    number = len(label)
    if number * (number - 1) // 2 <= 4 * most:
        i, j = np.triu_indices(number, 1)
        keep = np.flatnonzero(label[i] != label[j])
        if len(keep) > most:
            keep = np.sort(rng.choice(keep, most, replace=False))
        return np.stack([i[keep], j[keep]], 1)
    drawn = np.sort(rng.integers(number, size=(3 * most, 2)), axis=1)
    drawn = np.unique(drawn[label[drawn[:, 0]] != label[drawn[:, 1]]], axis=0)
    return drawn[np.sort(rng.choice(len(drawn), min(most, len(drawn)), replace=False))]
