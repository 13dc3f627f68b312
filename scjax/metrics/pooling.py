"""Metrics as ratios of sums, pooled over scenes, with bootstrap intervals.

One scene contributes (numerator, denominator) per metric. Both are summed over scenes, so results do not depend on
batches, shards or order, and scenes need not be in memory together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Float64

from scjax.scene import Scene, unpadded

Ratios = dict[str, tuple[float, float]]
"""Name of a metric -> (numerator, denominator)."""
Values = dict[str, float]


def singles(scenes: Scene | Iterable[Scene]) -> Iterator[Scene]:
    """Single NumPy scenes without padding, from one scene, a batch [n] or any iterable of either.

    Raises:
      ValueError: a batch has more than one axis.
    """
    if not isinstance(scenes, Scene):
        for scene in scenes:
            yield from singles(scene)
        return
    if len(scenes.batch_shape) > 1:
        raise ValueError(f"scenes have batch axes {scenes.batch_shape}: flatten them to a single one first")
    host = scenes.to_numpy()
    rows = (host[row] for row in range(host.batch_shape[0])) if host.batch_shape else (host,)
    for scene in rows:  # scenes without padding are not copied: copying costs as much as some metrics
        yield scene if scene.agent_mask.all() and scene.lane_mask.all() else unpadded(scene)


def pool(ratios: Iterable[Ratios]) -> Ratios:
    """Sums of numerators and denominators; a metric that a scene lacks adds nothing."""
    total: Ratios = {}
    for scene in ratios:
        for name, (numerator, denominator) in scene.items():
            over, under = total.get(name, (0.0, 0.0))
            total[name] = (over + numerator, under + denominator)
    return total


def values(ratios: Ratios) -> Values:
    """Numerator / denominator of every metric, NaN where nothing was counted."""
    return {name: ratio(*pair) for name, pair in ratios.items()}


def ratio(numerator: float, denominator: float) -> float:
    """The quotient; NaN if the denominator is 0."""
    return float(numerator / denominator) if denominator else math.nan


def intervals(
    scenes: Sequence[Ratios],
    clusters: Sequence[Hashable],
    summarize: Callable[[Ratios], Values] = values,
    *,
    draws: int = 1000,
    seed: int = 0,
    level: float = 0.95,
) -> dict[str, tuple[float, float]]:
    """Percentile bootstrap intervals of ``summarize(pool(scenes))``, resampling whole clusters.

    Scenes of one location are alike; resampling scenes would make intervals too narrow (metrics.md, baselines.md).

    Args:
      scenes: contribution of every scene.
      clusters: location of every scene.
      summarize: pooled ratios -> values.
      draws: number of bootstrap samples.
      seed: of the bootstrap.
      level: coverage.

    Returns:
      (low, high) per value; NaN with fewer than two clusters.

    Raises:
      ValueError: scenes and clusters differ in number.
    """
    if len(scenes) != len(clusters):
        raise ValueError(f"{len(scenes)} scenes but {len(clusters)} clusters: name the location of every scene")
    total = pool(scenes)
    groups = {cluster: row for row, cluster in enumerate(dict.fromkeys(clusters))}
    if len(groups) < 2:
        return {name: (math.nan, math.nan) for name in summarize(total)}
    names = list(total)
    table = np.zeros((len(groups), len(names), 2))
    for scene, cluster in zip(scenes, clusters, strict=True):
        table[groups[cluster]] += np.array([scene.get(name, (0.0, 0.0)) for name in names])
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(len(groups), np.full(len(groups), 1 / len(groups)), draws)
    sums = np.einsum("dc,cnk->dnk", weights.astype(np.float64), table)
    samples = [summarize({name: (float(p[0]), float(p[1])) for name, p in zip(names, s, strict=True)}) for s in sums]
    return {name: interval(np.array([draw[name] for draw in samples]), level) for name in samples[0]}


def interval(samples: Float64[np.ndarray, " draws"], level: float = 0.95) -> tuple[float, float]:
    """Central ``level`` of the finite samples; NaN without any."""
    finite = samples[np.isfinite(samples)]
    if not len(finite):
        return math.nan, math.nan
    low, high = np.quantile(finite, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
