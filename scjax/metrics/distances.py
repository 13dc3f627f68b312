"""Distances between pooled distributions: from moments (Fréchet) and from histograms (Jensen-Shannon).

Both need only sums over scenes, so populations of any size are compared without being held in memory.
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
    """``Moments`` of some values; they add up over scenes. Exact for whole numbers."""
    values = np.asarray(values, np.float64)
    return np.array([values.size, values.sum(), np.square(values).sum()])


def mean_and_deviation(sums: Moments) -> tuple[float, float]:
    """Mean, NaN over nothing, and unbiased standard deviation, NaN over fewer than two values."""
    number, total, squares = (float(x) for x in sums)
    if number == 0:
        return math.nan, math.nan
    mean = total / number
    return mean, math.sqrt(max(squares - total * mean, 0.0) / (number - 1)) if number > 1 else math.nan


def frechet(first: Moments, second: Moments) -> float:
    """sqrt((mu1 - mu2)^2 + (s1 - s2)^2), the Fréchet distance of two normal distributions on a line.

    NaN where either side has fewer than two values.
    """
    (mean1, deviation1), (mean2, deviation2) = mean_and_deviation(first), mean_and_deviation(second)
    return math.hypot(mean1 - mean2, deviation1 - deviation2)


@functools.cache
def bin_edges(low: float, high: float, width: float) -> Float64[np.ndarray, " edges"]:
    """Edges of the reference's histograms: multiples of ``width`` from ``low`` up to ``high``."""
    return np.arange(low, high + width, width)


def histogram(values: np.ndarray, low: float, high: float, width: float) -> Float64[np.ndarray, " bins"]:
    """Counts of values clipped into [low, high]; they add up over scenes."""
    edges, ordered = bin_edges(low, high, width), np.sort(np.clip(values, low, high))
    # What np.histogram does with edges, without its checks, which take longer than the dozen values of a scene.
    below = ordered.searchsorted(edges)
    below[-1] = ordered.searchsorted(edges[-1], side="right")  # the last bin is closed
    return np.diff(below).astype(np.float64)


def jensen_shannon(first: Float64[np.ndarray, " bins"], second: Float64[np.ndarray, " bins"]) -> float:
    """Squared Jensen-Shannon distance of two histograms, natural logarithm: 0 for equal ones, at most ln 2.

    NaN where either is empty.
    """
    if not first.sum() or not second.sum():
        return math.nan
    return float(jensenshannon(first, second) ** 2)
