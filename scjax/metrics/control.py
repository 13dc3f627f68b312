"""Control metrics: does a sample follow its condition? (metrics.md §4.2)

CCS: mean cosine of paired descriptors. SPG: its gain over shuffled pairs. CSC: correlation of distances between scenes.
Sample i answers the condition of reference i. All functions take standardized descriptors of one level.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Sequence

import numpy as np
from jaxtyping import Float64, Int
from scipy.stats import rankdata

from scjax.metrics.descriptors import LEVELS, Descriptor, Standard
from scjax.metrics.pooling import Values, interval

_FEW = 3000  # scenes: up to here distances come from one matrix product

Vectors = Float64[np.ndarray, "scenes features"]


@dataclasses.dataclass(frozen=True)
class ControlFrame:
    """Shared setting for populations with the same references: one standardization, the same shuffles and pairs."""

    standard: Standard
    reference: Descriptor
    shuffles: Int[np.ndarray, "shuffles scenes"]
    pairs: Int[np.ndarray, "pairs 2"]

    @classmethod
    def of(
        cls,
        raw: Descriptor,
        clusters: Sequence[Hashable],
        rng: np.random.Generator,
        *,
        shuffles: int = 10,
        pairs: int = 200_000,
    ) -> ControlFrame:
        """From the raw descriptors of the references and their location clusters.

        Args:
          shuffles: number of shuffles for SPG; with 0, SPG is NaN.
          pairs: largest number of scene pairs for CSC.

        Raises:
          ValueError: there is no reference, or (with shuffles) one cluster holds more than half of them.
        """
        standard = Standard.of(raw)
        bootstrap_samples = derangements(clusters, rng, shuffles) if shuffles else np.zeros((0, len(clusters)), int)
        return cls(standard, standard(raw), bootstrap_samples, scene_pairs(clusters, rng, pairs))

    def __call__(self, raw: Descriptor) -> Values:
        """CCS, SPG and CSC at the three levels; scene i of ``raw`` answers reference i."""
        ours, values = self.standard(raw), {}
        for level in LEVELS:
            x, y = getattr(self.reference, level), getattr(ours, level)
            values[f"{level} CCS"] = ccs(x, y)
            values[f"{level} SPG"] = spg(x, y, self.shuffles)
            values[f"{level} CSC"] = csc(x, y, self.pairs)
        return values

    def intervals(
        self, raw: Descriptor, clusters: Sequence[Hashable], *, draws: int = 200, seed: int = 0, level: float = 0.95
    ) -> dict[str, tuple[float, float]]:
        """Bootstrap intervals of the values, resampling whole location clusters (not pairs).

        Shuffles and pairs stay fixed; scenes and pairs are weighted by how often their clusters were drawn. NaN with
        fewer than two clusters.
        """
        bootstrap_samples = self.bootstrap_samples(raw, clusters, draws=draws, seed=seed)
        if not bootstrap_samples:
            return dict.fromkeys(self(raw), (float("nan"), float("nan")))
        return {name: interval(values, level) for name, values in bootstrap_samples.items()}

    def bootstrap_samples(
        self, raw: Descriptor, clusters: Sequence[Hashable], *, draws: int = 200, seed: int = 0
    ) -> dict[str, Float64[np.ndarray, " draws"]]:
        """Name -> its value in every bootstrap sample; empty with fewer than two clusters.

        Equal clusters and seeds draw the same locations, so differences between two populations are paired.
        """
        label = np.unique(np.array([str(cluster) for cluster in clusters]), return_inverse=True)[1]
        number = int(label.max(initial=-1)) + 1
        if number < 2:
            return {}
        weights = np.random.default_rng(seed).multinomial(number, np.full(number, 1 / number), draws)
        weights = weights[:, label].astype(np.float64)
        i, j = self.pairs.T
        ours, values = self.standard(raw), {}
        for name in LEVELS:
            x, y = getattr(self.reference, name), getattr(ours, name)
            paired = cosines(x, y)
            gain = paired - np.mean([cosines(x[row], y) for row in self.shuffles] or [np.full(len(x), np.nan)], axis=0)
            apart = _distances(x, self.pairs), _distances(y, self.pairs)
            values[f"{name} CCS"] = weights @ paired / weights.sum(1)
            values[f"{name} SPG"] = weights @ gain / weights.sum(1)
            values[f"{name} CSC"] = np.array([_correlation(*apart, row[i] * row[j]) for row in weights])
        return values


def ccs(reference: Vectors, sample: Vectors) -> float:
    """CCS: mean cosine of reference i with sample i."""
    return float(cosines(reference, sample).mean()) if len(reference) else float("nan")


def spg(reference: Vectors, sample: Vectors, shuffles: Int[np.ndarray, "shuffles scenes"]) -> float:
    """SPG: CCS minus the mean cosine with shuffled references (``derangements``)."""
    shuffled = [ccs(reference[shuffle], sample) for shuffle in shuffles]
    return ccs(reference, sample) - float(np.mean(shuffled)) if shuffled else float("nan")


def csc(reference: Vectors, sample: Vectors, pairs: Int[np.ndarray, "pairs 2"], *, ranks: bool = False) -> float:
    """CSC: correlation, over pairs of scenes, of reference distances with sample distances.

    Distance is 1 - cosine. Pearson, or with ``ranks`` Spearman. NaN where either side is constant.
    """
    ours, theirs = _distances(sample, pairs), _distances(reference, pairs)
    if len(pairs) < 2 or not ours.std() or not theirs.std():
        return float("nan")
    if ranks:
        ours, theirs = rankdata(ours), rankdata(theirs)
    return float(np.corrcoef(theirs, ours)[0, 1])


def _correlation(first: np.ndarray, second: np.ndarray, weight: np.ndarray) -> float:
    """Weighted Pearson correlation; NaN where either side is constant."""
    total = weight.sum()
    if not total:
        return float("nan")
    one, two = first - weight @ first / total, second - weight @ second / total
    spread = np.sqrt((weight @ one**2) * (weight @ two**2))
    return float(weight @ (one * two) / spread) if spread > 0 else float("nan")


def _distances(vectors: Vectors, pairs: np.ndarray) -> np.ndarray:
    """1 - cosine of each pair.

    Small sets use one matrix product, as the golden rank correlations did: rounding orders the ties of repeated scenes.
    """
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
    i, j = pairs.T
    return 1 - ((unit @ unit.T)[i, j] if len(unit) <= _FEW else (unit[i] * unit[j]).sum(-1))


def cosines(first: Vectors, second: Vectors) -> Float64[np.ndarray, " scenes"]:
    """Cosine row by row; 0 where either vector is zero."""
    norms = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
    return (first * second).sum(-1) / np.where(norms > 0, norms, 1.0)


def derangements(
    clusters: Sequence[Hashable], rng: np.random.Generator, count: int = 10
) -> Int[np.ndarray, "shuffles scenes"]:
    """Random permutations that assign every scene one of another cluster.

    Raises:
      ValueError: one cluster holds more than half of the scenes, so no such permutation exists.
    """
    label = np.unique(np.array([str(cluster) for cluster in clusters]), return_inverse=True)[1]
    number = len(label)
    largest = int(np.bincount(label).max()) if number else 0
    if not number or 2 * largest > number:
        raise ValueError(
            f"{largest} of {number} scenes share a location cluster: shuffling moves each scene to another cluster, "
            "so none may hold more than half of the scenes"
        )
    # Sort scenes by cluster and roll by at least the largest cluster: no scene meets its own cluster.
    permutations = np.empty((count, number), int)
    for row in permutations:
        names = rng.permutation(label.max() + 1)
        order = np.lexsort((rng.random(number), names[label]))
        row[order] = np.roll(order, int(rng.integers(largest, number - largest + 1)))
    return _mixed(permutations, label, rng)


def _mixed(shuffles: np.ndarray, label: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random swaps that keep every scene away from its own cluster; the roll alone is not random enough."""
    number = len(label)
    for row in shuffles:
        for i, j in rng.integers(number, size=(4 * number, 2)):
            if label[i] != label[row[j]] and label[j] != label[row[i]]:
                row[i], row[j] = row[j], row[i]
    return shuffles


def scene_pairs(
    clusters: Sequence[Hashable], rng: np.random.Generator, most: int = 200_000
) -> Int[np.ndarray, "pairs 2"]:
    """Pairs i < j of scenes of different clusters; at most ``most``, chosen at random."""
    label = np.unique(np.array([str(cluster) for cluster in clusters]), return_inverse=True)[1]
    number = len(label)
    if number * (number - 1) // 2 <= 4 * most:
        i, j = np.triu_indices(number, 1)
        keep = np.flatnonzero(label[i] != label[j])
        if len(keep) > most:
            keep = np.sort(rng.choice(keep, most, replace=False))
        return np.stack([i[keep], j[keep]], 1)
    bootstrap_samples = np.sort(rng.integers(number, size=(3 * most, 2)), axis=1)
    bootstrap_samples = np.unique(
        bootstrap_samples[label[bootstrap_samples[:, 0]] != label[bootstrap_samples[:, 1]]], axis=0
    )
    return bootstrap_samples[
        np.sort(rng.choice(len(bootstrap_samples), min(most, len(bootstrap_samples)), replace=False))
    ]
