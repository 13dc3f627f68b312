"""Distances between distributions: Fréchet from moments, Jensen-Shannon from histograms.

Both need sums over scenes only, so sets of any size are compared without holding them in memory.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from jaxtyping import Float64
from scipy.spatial.distance import jensenshannon

Moments = Float64[np.ndarray, "*b 3"]
"""Number of values, their sum, their sum of squares."""


def moments(values: np.ndarray) -> Float64[np.ndarray, " 3"]:
    """``Moments`` of values; they add up over scenes. Exact for integers."""
    values = np.asarray(values, np.float64)
    return np.array([values.size, values.sum(), np.square(values).sum()])


def mean_and_deviation(sums: Moments) -> tuple[float, float]:
    """Mean (NaN without values) and unbiased standard deviation (NaN below two values)."""
    number, total, squares = (float(x) for x in sums)
    if number == 0:
        return math.nan, math.nan
    mean = total / number
    return mean, math.sqrt(max(squares - total * mean, 0.0) / (number - 1)) if number > 1 else math.nan


def frechet(first: Moments, second: Moments) -> float:
    """sqrt((mu1 - mu2)^2 + (s1 - s2)^2), the Fréchet distance of two univariate normal distributions.

    NaN if either side has fewer than two values.
    """
    (mean1, deviation1), (mean2, deviation2) = mean_and_deviation(first), mean_and_deviation(second)
    return math.hypot(mean1 - mean2, deviation1 - deviation2)


@functools.cache
def bin_edges(low: float, high: float, width: float) -> Float64[np.ndarray, " edges"]:
    """Bin edges as in the reference code: ``low`` plus multiples of ``width``, up to ``high``."""
    return np.arange(low, high + width, width)


def histogram(values: np.ndarray, low: float, high: float, width: float) -> Float64[np.ndarray, " bins"]:
    """Bin counts of values clipped into [low, high]; they add up over scenes."""
    edges, ordered = bin_edges(low, high, width), np.sort(np.clip(values, low, high))
    # As np.histogram with edges, without its checks, which take longer than the few values of a scene.
    below = ordered.searchsorted(edges)
    below[-1] = ordered.searchsorted(edges[-1], side="right")  # the last bin is closed
    return np.diff(below).astype(np.float64)


def jensen_shannon(first: Float64[np.ndarray, " bins"], second: Float64[np.ndarray, " bins"]) -> float:
    """Squared Jensen-Shannon distance of two histograms, natural logarithm: 0 for equal ones, at most ln 2.

    NaN if either is empty.
    """
    if not first.sum() or not second.sum():
        return math.nan
    return float(jensenshannon(first, second) ** 2)
