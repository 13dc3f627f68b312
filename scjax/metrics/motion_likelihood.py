"""Likelihood of logged values under simulated ones, and the features of the Waymo Open Sim Agents Challenge."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float64, Int


@dataclasses.dataclass(frozen=True)
class HistogramSpec:
    """How the distribution of a feature is estimated: ``bins`` equal ones from ``low`` to ``high``.

    Values outside count in the first or last bin. ``pseudocount`` is added to the count of each bin.
    """

    low: float
    high: float
    bins: int
    pseudocount: float = 0.1


INDICATION = HistogramSpec(-0.5, 1.5, 2, 0.001)
"""Of features that happen or not in a roll-out."""

FEATURES: Mapping[str, HistogramSpec] = MappingProxyType(
    {
        "linear_speed": HistogramSpec(0.0, 25.0, 10),
        "linear_acceleration": HistogramSpec(-12.0, 12.0, 11),
        "angular_speed": HistogramSpec(-0.628, 0.628, 11),
        "angular_acceleration": HistogramSpec(-3.14, 3.14, 11),
        "distance_to_nearest_object": HistogramSpec(-5.0, 40.0, 10),
        "collision_indication": INDICATION,
        "time_to_collision": HistogramSpec(0.0, 5.0, 10),
        "distance_to_road_edge": HistogramSpec(-20.0, 40.0, 10),
        "offroad_indication": INDICATION,
        "traffic_light_violation": INDICATION,
    }
)
"""Ranges and bins of the challenge of 2024 and 2025 [m/s, m/s^2, rad/s, rad/s^2, m, -, s, m, -, -]."""

WEIGHTS_2025: Mapping[str, float] = MappingProxyType(
    {
        "linear_speed": 0.05,
        "linear_acceleration": 0.05,
        "angular_speed": 0.05,
        "angular_acceleration": 0.05,
        "distance_to_nearest_object": 0.10,
        "collision_indication": 0.25,
        "time_to_collision": 0.10,
        "distance_to_road_edge": 0.05,
        "offroad_indication": 0.25,
        "traffic_light_violation": 0.05,
    }
)
"""Weights of the likelihoods in the realism meta-metric of 2025."""

WEIGHTS_2024: Mapping[str, float] = MappingProxyType(
    WEIGHTS_2025 | {"distance_to_road_edge": 0.10, "traffic_light_violation": 0.0}
)
"""Weights of 2024."""

BUCKETS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "kinematic": ("linear_speed", "linear_acceleration", "angular_speed", "angular_acceleration"),
        "interactive": ("distance_to_nearest_object", "collision_indication", "time_to_collision"),
        "map_based": ("distance_to_road_edge", "offroad_indication", "traffic_light_violation"),
    }
)
"""Groups of features, for tables."""


def bin_numbers(values: Float64[np.ndarray, "*any"], spec: HistogramSpec) -> Int[np.ndarray, "*any"]:
    """The bin of each value; a value between two bins belongs to the upper one. NaN belongs to the first."""
    share = (np.nan_to_num(values, nan=spec.low) - spec.low) / (spec.high - spec.low)
    return np.clip(np.floor(share * spec.bins), 0, spec.bins - 1).astype(int)


def log_likelihoods(
    logged: Float64[np.ndarray, "objects steps"],
    simulated: Float64[np.ndarray, "rollouts objects simulated_steps"],
    valid: Bool[np.ndarray, "rollouts objects simulated_steps"],
    spec: HistogramSpec,
) -> Float64[np.ndarray, "objects steps"]:
    """Logarithm of the probability of each logged value under the simulated values of the same object.

    The histogram of an object is over its valid values in all roll-outs and steps. Without any it is uniform.
    """
    objects = logged.shape[0]
    cells = bin_numbers(simulated, spec) + spec.bins * np.arange(objects)[:, None]
    counts = np.bincount(cells[valid], minlength=objects * spec.bins).reshape(objects, spec.bins) + spec.pseudocount
    logs = np.log(counts / counts.sum(-1, keepdims=True))
    return np.take_along_axis(logs, bin_numbers(logged, spec), 1)
