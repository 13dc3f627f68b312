"""Errors and calibration of predicted numbers of agents or lanes (metrics.md §5)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import rankdata

from scjax.metrics.pooling import Values

_RELATIVE_TOLERANCE = 0.1


class Calibration(NamedTuple):
    """A group of scenes with similar predictions: mean predicted number, mean true number, number of scenes."""

    predicted: float
    true: float
    scenes: int


def count_errors(true: Int[np.ndarray, " scenes"], predicted: Float[np.ndarray, " scenes"]) -> Values:
    """Errors over scenes; NaN without scenes.

    Args:
      true: numbers of elements.
      predicted: their predictions, not necessarily integers.

    Returns:
      mae, bias (predicted - true); exact, within_1, within_10_percent: shares of scenes, with rounded predictions;
      spearman: rank correlation, NaN where either side is constant.

    Raises:
      ValueError: a prediction is not finite.
    """
    if not np.isfinite(predicted).all():
        raise ValueError(f"{int((~np.isfinite(predicted)).sum())} predicted numbers are NaN or infinite")
    if not len(true):
        return dict.fromkeys(("mae", "bias", "exact", "within_1", "within_10_percent", "spearman"), float("nan"))
    error, whole = predicted - true, np.abs(np.round(predicted) - true)
    first, second = rankdata(true), rankdata(predicted)
    varied = first.std() > 0 and second.std() > 0
    errors = {
        "mae": np.abs(error).mean(),
        "bias": error.mean(),
        "exact": (whole == 0).mean(),
        "within_1": (whole <= 1).mean(),
        "within_10_percent": (whole <= _RELATIVE_TOLERANCE * true).mean(),
        "spearman": np.corrcoef(first, second)[0, 1] if varied else np.nan,
    }
    return {name: float(value) for name, value in errors.items()}


def calibration(
    true: Int[np.ndarray, " scenes"], predicted: Float[np.ndarray, " scenes"], groups: int = 10
) -> list[Calibration]:
    """Scenes grouped by predicted number (deciles): calibrated predictions have equal means in each group."""
    order = np.argsort(predicted, kind="stable")
    parts = [part for part in np.array_split(order, groups) if len(part)]
    return [Calibration(float(predicted[part].mean()), float(true[part].mean()), len(part)) for part in parts]
