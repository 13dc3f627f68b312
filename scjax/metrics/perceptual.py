"""Perceptual metrics: Fréchet distance of lane embeddings (metrics.md §1) and descriptors of latents.

Both depend on the autoencoder: never compare values of different autoencoders.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
import scipy.linalg
from jaxtyping import Float, Float64

from scjax.metrics.descriptors import Descriptor


@dataclasses.dataclass
class Gaussian:
    """A Gaussian as sums over vectors, which add up over parts of a set.

    Attributes:
      number: number of vectors.
      total: sum of the vectors.
      products: sum of their outer products.
    """

    number: float
    total: Float64[np.ndarray, " width"]
    products: Float64[np.ndarray, "width width"]

    @classmethod
    def of(cls, vectors: Float[np.ndarray, "vectors width"]) -> Gaussian:
        """The sums of one set of vectors."""
        rows = np.asarray(vectors, np.float64)
        return cls(float(len(rows)), rows.sum(0), rows.T @ rows)

    def __add__(self, other: Gaussian) -> Gaussian:
        return Gaussian(self.number + other.number, self.total + other.total, self.products + other.products)

    @property
    def mean(self) -> Float64[np.ndarray, " width"]:
        return self.total / self.number

    @property
    def covariance(self) -> Float64[np.ndarray, "width width"]:
        """The unbiased covariance."""
        centered = self.products - np.outer(self.total, self.total) / self.number
        return centered / (self.number - 1)


def gaussian_frechet(first: Gaussian, second: Gaussian) -> float:
    """sqrt(|m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2))); NaN if a side has fewer than two vectors."""
    if min(first.number, second.number) < 2:
        return float("nan")
    root = _root(first.covariance)
    # S1^(1/2) S2 S1^(1/2) has the eigenvalues of S1 S2 and is symmetric.
    shared = np.sqrt(np.maximum(scipy.linalg.eigvalsh(root @ second.covariance @ root), 0)).sum()
    spread = np.trace(first.covariance) + np.trace(second.covariance) - 2 * shared
    return float(np.sqrt(max(np.square(first.mean - second.mean).sum() + spread, 0.0)))


def latent_descriptor(
    lanes: Sequence[np.ndarray], agents: Sequence[np.ndarray], states: Sequence[np.ndarray]
) -> Descriptor:
    """Descriptors of scenes for ``ControlFrame`` from the latents of an autoencoder.

    Args:
      lanes, agents: posterior means of each scene [elements, latent], pooled to [mean, deviation]; agent 0, the ego, is
        left out. Zeros where a scene has no elements.
      states: final lane states of each scene [lanes, width]; their mean describes the whole scene.
    """
    return Descriptor(
        _stack([_pooled(one) for one in lanes]),
        _stack([_pooled(one[1:]) for one in agents]),
        _stack([one.mean(0) if len(one) else np.zeros(one.shape[1]) for one in states]),
    )


def _pooled(vectors: np.ndarray) -> np.ndarray:
    if not len(vectors):
        return np.zeros(2 * vectors.shape[1])
    return np.concatenate([vectors.mean(0), vectors.std(0)])


def _stack(rows: Iterable[np.ndarray]) -> np.ndarray:
    return np.stack([np.asarray(row, np.float64) for row in rows])


def _root(matrix: np.ndarray) -> np.ndarray:
    values, vectors = scipy.linalg.eigh(matrix)
    return (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
