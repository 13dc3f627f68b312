"""How well predicted numbers of agents or lanes meet the true ones (metrics.md §5)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.stats import rankdata

from scjax.metrics.pooling import Values

_NEAR = 0.1  # relative


class Calibration(NamedTuple):
    """One group of scenes of like predicted number: mean predicted, mean true, scenes."""

    predicted: float
    true: float
    scenes: int


def count_errors(true: Int[np.ndarray, " scenes"], predicted: Float[np.ndarray, " scenes"]) -> Values:
    """Errors over scenes; NaN over none.

    Args:
      true: numbers of elements.
      predicted: their predictions; need not be whole.

    Returns:
      mae, bias (predicted - true); exact, within_1, within_10_percent: shares of scenes, predictions rounded;
      spearman: rank correlation, NaN where either side does not vary.

    Raises:
      ValueError: if a prediction is not finite.
    """
    if not np.isfinite(predicted).all():
        raise ValueError(f"{int((~np.isfinite(predicted)).sum())} predicted numbers are NaN or infinite")
    if not len(true):
        return dict.fromkeys(("mae", "bias", "exact", "within_1", "within_10_percent", "spearman"), float("nan"))
    error, whole = predicted - true, np.abs(np.round(predicted) - true)
    first, second = rankdata(true), rankdata(predicted)
    varied = first.std() > 0 and second.std() > 0
    found = {
        "mae": np.abs(error).mean(), "bias": error.mean(), "exact": (whole == 0).mean(),
        "within_1": (whole <= 1).mean(), "within_10_percent": (whole <= _NEAR * true).mean(),
        "spearman": np.corrcoef(first, second)[0, 1] if varied else np.nan,
    }  # fmt: skip
    return {name: float(value) for name, value in found.items()}


def calibration(
    true: Int[np.ndarray, " scenes"], predicted: Float[np.ndarray, " scenes"], groups: int = 10
) -> list[Calibration]:
    """Scenes in groups of like predicted number (deciles): a calibrated prediction has equal means in each."""
    order = np.argsort(predicted, kind="stable")
    parts = [part for part in np.array_split(order, groups) if len(part)]
    return [Calibration(float(predicted[part].mean()), float(true[part].mean()), len(part)) for part in parts]
