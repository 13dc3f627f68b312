"""Retrieval baselines: a recorded scene for each reference, by chance, counts, caption or both.

Scenes of the reference's own location are excluded. A model should exceed these baselines in control and come near
their realism (baselines.md).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from tqdm import tqdm

from scjax.evaluate.requests import caption_of
from scjax.evaluate.sources import SceneSource

RANDOM_AMONG = 5  # "other scene, same counts" is one of so many scenes with the nearest counts
_CAPTION_AMONG = 50  # "nearest caption + counts" is among so many scenes with the nearest counts


@dataclasses.dataclass(frozen=True)
class Index:
    """Counts, locations and captions of the scenes of a source.

    Attributes:
      counts: number of lanes and of agents without the ego, per scene.
      clusters: location per scene.
      captions: caption per scene; empty if not needed.
    """

    counts: Int[np.ndarray, "scenes 2"]
    clusters: np.ndarray
    captions: list[str]

    @classmethod
    def of(cls, source: SceneSource, *, captions: bool, title: str = "index") -> Index:
        """The index of a source; reads every scene once."""
        counts, texts = [], []
        for row in tqdm(range(len(source.clusters)), title, unit="scene", mininterval=1.0):
            (scene,) = source.read([row])
            counts.append((len(scene.lane_mask), len(scene.agent_mask) - source.ego))
            if captions:
                texts.append(caption_of(scene))
        return cls(np.array(counts, int).reshape(-1, 2), np.array(source.clusters, str), texts)


Rule = Callable[[Any, Bool[np.ndarray, " candidates"], int, np.random.Generator], int]
"""(distances, candidates that are allowed, row of the query, random generator) -> row of the candidates."""


def retrieve(
    rule: str, queries: Index, candidates: Index, *, seed: int = 0, progress: bool = True
) -> Int[np.ndarray, " queries"]:
    """The row of the candidate that a rule retrieves for every query.

    Args:
      rule: one of ``RULES``.
      queries: index of the references.
      candidates: index of the retrieval set.
      seed: of random choices and ties.
      progress: whether to show a progress bar.

    Raises:
      ValueError: an unknown rule, missing captions, or candidates of one location only.
    """
    if rule not in RULES:
        raise ValueError(f"unknown baseline {rule!r}: choose among {', '.join(RULES)}")
    find = RULES[rule]
    distances = (
        _CountDistances(queries, candidates) if "caption" not in rule else _CaptionDistances(queries, candidates)
    )
    rng, rows = np.random.default_rng(seed), []
    for row in tqdm(range(len(queries.clusters)), rule, unit="scene", mininterval=1.0, disable=not progress):
        allowed = candidates.clusters != queries.clusters[row]
        if not allowed.any():
            raise ValueError(
                f"every scene of the retrieval set lies at {queries.clusters[row]}, as a reference does: "
                "name a larger retrieval set"
            )
        rows.append(find(distances, allowed, row, rng))
    return np.array(rows, int)


class _CountDistances:
    """Distances of counts: |difference of lanes| + |difference of agents|."""

    def __init__(self, queries: Index, candidates: Index):
        self.queries, self.candidates = queries, candidates

    def count_distance(self, row: int) -> Int[np.ndarray, " candidates"]:
        return np.abs(self.candidates.counts - self.queries.counts[row]).sum(1)


class _CaptionDistances(_CountDistances):
    """Adds the similarity of captions: cosine of tf-idf over words and pairs of words."""

    def __init__(self, queries: Index, candidates: Index):
        super().__init__(queries, candidates)
        if not queries.captions or not candidates.captions:
            raise ValueError("this baseline compares captions: index both sources with captions=True")
        self._candidates, self._queries = tf_idf(candidates.captions, queries.captions)

    def similarity(self, row: int) -> Float[np.ndarray, " candidates"]:
        return (self._candidates @ self._queries[[row]].T).toarray()[:, 0]


def tf_idf(corpus: Sequence[str], texts: Sequence[str]) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """tf-idf unit vectors over words and pairs of words; weights log((1 + n) / (1 + documents)) + 1 from ``corpus``."""
    vocabulary: dict[str, int] = {}
    counted = _terms(corpus, vocabulary, grow=True)
    documents = np.bincount(counted.indices, minlength=len(vocabulary))
    weight = np.log((1 + len(corpus)) / (1 + documents)) + 1
    return _unit(counted, weight), _unit(_terms(texts, vocabulary, grow=False), weight)


def _terms(texts: Sequence[str], vocabulary: dict[str, int], *, grow: bool) -> sparse.csr_matrix:
    rows, columns = [], []
    for row, text in enumerate(texts):
        words = "".join(c if c.isalnum() else " " for c in text.lower()).split()
        for term in [*words, *(f"{a} {b}" for a, b in itertools.pairwise(words))]:
            if grow:
                vocabulary.setdefault(term, len(vocabulary))
            if term in vocabulary:
                rows.append(row)
                columns.append(vocabulary[term])
    matrix = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(texts), len(vocabulary)))
    matrix.sum_duplicates()
    return matrix


def _unit(matrix: sparse.csr_matrix, weight: np.ndarray) -> sparse.csr_matrix:
    weighed = sparse.csr_matrix(matrix.multiply(weight[None]))
    norm = np.sqrt(np.asarray(weighed.multiply(weighed).sum(1)))[:, 0]
    return sparse.csr_matrix(sparse.diags(1 / np.where(norm > 0, norm, 1.0)) @ weighed)


def _chance(distances: _CountDistances, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    return int(rng.choice(np.flatnonzero(allowed)))


def _counts(distances: _CountDistances, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    return _nearest(distances.count_distance(row), allowed, 1, rng)[0]


def _other(distances: _CountDistances, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    return int(rng.choice(_nearest(distances.count_distance(row), allowed, RANDOM_AMONG, rng)))


def _caption(distances: _CaptionDistances, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    return _nearest(-distances.similarity(row), allowed, 1, rng)[0]


def _both(distances: _CaptionDistances, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    near = _nearest(distances.count_distance(row), allowed, _CAPTION_AMONG, rng)
    return near[int(np.argmax(distances.similarity(row)[near]))]


def _nearest(distance: np.ndarray, allowed: np.ndarray, count: int, rng: np.random.Generator) -> list[int]:
    """Rows with the smallest distances; ties in random order."""
    rows = np.flatnonzero(allowed)
    return rows[np.lexsort((rng.random(len(rows)), distance[rows]))[:count]].tolist()


RULES: dict[str, Rule] = {
    "chance": _chance,
    "count-matched": _counts,
    "nearest caption": _caption,
    "nearest caption + counts": _both,
    "other scene, same counts": _other,
}
"""chance: any scene. count-matched: nearest counts. nearest caption: most similar caption. nearest caption + counts:
most
similar caption among the 50 scenes with the nearest counts. other scene, same counts: one of the 5 with the nearest
counts, at random."""
