"""Baselines that find a recorded scene instead of making one: by chance, by counts, by caption, by both.

A scene of the reference's own location is never found. A model has to beat these rows on control, and to come near
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

from scjax.evaluate.captions import caption_of
from scjax.evaluate.sources import Source

DRAWN_FROM = 5  # scenes of the nearest counts, of which "other scene, same counts" is drawn
_CANDIDATES = 50  # scenes of the nearest counts, among which the caption decides


@dataclasses.dataclass(frozen=True)
class Index:
    """What retrieval knows of the scenes of a source.

    Attributes:
      counts: lanes and agents of each, the ego left out.
      clusters: location of each.
      captions: of each; empty where not asked for.
    """

    counts: Int[np.ndarray, "scenes 2"]
    clusters: np.ndarray
    captions: list[str]

    @classmethod
    def of(cls, source: Source, *, captions: bool, title: str = "index") -> Index:
        """Reads every scene once."""
        counts, texts = [], []
        for row in tqdm(range(len(source.clusters)), title, unit="scene", mininterval=1.0):
            (scene,) = source.read([row])
            counts.append((len(scene.lane_mask), len(scene.agent_mask) - source.ego))
            if captions:
                texts.append(caption_of(scene))
        return cls(np.array(counts, int).reshape(-1, 2), np.array(source.clusters, str), texts)


Rule = Callable[[Any, Bool[np.ndarray, " bank"], int, np.random.Generator], int]
"""(what the rule knows, scenes it may find, reference, draws) -> row of the bank."""


def retrieve(
    rule: str, wanted: Index, bank: Index, *, seed: int = 0, progress: bool = True
) -> Int[np.ndarray, " wanted"]:
    """The bank's scene for every reference.

    Args:
      rule: one of ``RULES``.
      seed: of draws and of ties.

    Raises:
      ValueError: an unknown rule, one that needs captions without any, or a bank that holds one location only.
    """
    if rule not in RULES:
        raise ValueError(f"unknown baseline {rule!r}: choose among {', '.join(RULES)}")
    find = RULES[rule]
    known = _Known(wanted, bank) if "caption" not in rule else _Captioned(wanted, bank)
    rng, found = np.random.default_rng(seed), []
    for row in tqdm(range(len(wanted.clusters)), rule, unit="scene", mininterval=1.0, disable=not progress):
        allowed = bank.clusters != wanted.clusters[row]
        if not allowed.any():
            raise ValueError(
                f"every scene of the bank lies at {wanted.clusters[row]}, as a reference does: name a larger bank"
            )
        found.append(find(known, allowed, row, rng))
    return np.array(found, int)


class _Known:
    """Distances of counts: |lanes| + |agents|."""

    def __init__(self, wanted: Index, bank: Index):
        self.wanted, self.bank = wanted, bank

    def apart(self, row: int) -> Int[np.ndarray, " bank"]:
        return np.abs(self.bank.counts - self.wanted.counts[row]).sum(1)


class _Captioned(_Known):
    """Similarity of captions, too: cosine of tf-idf over words and pairs of words."""

    def __init__(self, wanted: Index, bank: Index):
        super().__init__(wanted, bank)
        if not wanted.captions or not bank.captions:
            raise ValueError("this baseline finds captions: index both sources with captions=True")
        self._bank, self._wanted = tf_idf(bank.captions, wanted.captions)

    def alike(self, row: int) -> Float[np.ndarray, " bank"]:
        return (self._bank @ self._wanted[[row]].T).toarray()[:, 0]


def tf_idf(bank: Sequence[str], texts: Sequence[str]) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Unit vectors of words and pairs of words, weighed by log((1 + n) / (1 + documents)) + 1 over the bank."""
    vocabulary: dict[str, int] = {}
    counted = _terms(bank, vocabulary, grow=True)
    documents = np.bincount(counted.indices, minlength=len(vocabulary))
    weight = np.log((1 + len(bank)) / (1 + documents)) + 1
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


def _chance(known: _Known, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    return int(rng.choice(np.flatnonzero(allowed)))


def _counts(known: _Known, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    return _nearest(known.apart(row), allowed, 1, rng)[0]


def _other(known: _Known, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    return int(rng.choice(_nearest(known.apart(row), allowed, DRAWN_FROM, rng)))


def _caption(known: _Captioned, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    return _nearest(-known.alike(row), allowed, 1, rng)[0]


def _both(known: _Captioned, allowed: np.ndarray, row: int, rng: np.random.Generator) -> int:
    near = _nearest(known.apart(row), allowed, _CANDIDATES, rng)
    return near[int(np.argmax(known.alike(row)[near]))]


def _nearest(distance: np.ndarray, allowed: np.ndarray, count: int, rng: np.random.Generator) -> list[int]:
    """Rows of the least distances; equal ones in random order."""
    rows = np.flatnonzero(allowed)
    return rows[np.lexsort((rng.random(len(rows)), distance[rows]))[:count]].tolist()


RULES: dict[str, Rule] = {
    "chance": _chance,
    "count-matched": _counts,
    "nearest caption": _caption,
    "nearest caption + counts": _both,
    "other scene, same counts": _other,
}
"""chance: any scene. count-matched: the nearest counts. nearest caption: the most alike. nearest caption + counts: the
most alike among the 50 of the nearest counts. other scene, same counts: one of the 5 of the nearest counts (U)."""
