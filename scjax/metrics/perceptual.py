"""Fréchet distance of Gaussians fitted to embeddings of lanes (metrics.md §1), and control in an autoencoder's latents.

Both depend on the autoencoder: values of different ones are never compared.
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
    """Sums of vectors, which add up over any parts of a population.

    Attributes:
      number: of vectors.
      total: their sum.
      products: sum of their outer products.
    """

    number: float
    total: Float64[np.ndarray, " width"]
    products: Float64[np.ndarray, "width width"]

    @classmethod
    def of(cls, vectors: Float[np.ndarray, "vectors width"]) -> Gaussian:
        """Of one part."""
        rows = np.asarray(vectors, np.float64)
        return cls(float(len(rows)), rows.sum(0), rows.T @ rows)

    def __add__(self, other: Gaussian) -> Gaussian:
        return Gaussian(self.number + other.number, self.total + other.total, self.products + other.products)

    @property
    def mean(self) -> Float64[np.ndarray, " width"]:
        return self.total / self.number

    @property
    def covariance(self) -> Float64[np.ndarray, "width width"]:
        """Unbiased."""
        centred = self.products - np.outer(self.total, self.total) / self.number
        return centred / (self.number - 1)


def frechet(first: Gaussian, second: Gaussian) -> float:
    """sqrt(|m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2))); NaN with fewer than two vectors on a side."""
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
    """Descriptors of scenes for control (``ControlFrame``) from an autoencoder.

    Lanes and agents pool posterior means as [mean, deviation] like the geometric descriptor, the ego (agent 0) left
    out; the scene as a whole is the mean state of its lanes. Zeros where a scene has none.
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
