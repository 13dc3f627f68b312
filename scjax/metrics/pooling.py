"""Metrics as ratios of sums: what one scene contributes, pooled over any number of scenes, with an interval.

A metric of one scene is (numerator, denominator). Sums of both over scenes give the pooled value, so that results do
not depend on how scenes are batched, sharded or ordered, and a list of scenes never has to be in memory.
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
      ValueError: on a batch of more than one axis.
    """
    if not isinstance(scenes, Scene):
        for scene in scenes:
            yield from singles(scene)
        return
    if len(scenes.batch_shape) > 1:
        raise ValueError(f"scenes have batch axes {scenes.batch_shape}: flatten them to a single one first")
    host = scenes.to_numpy()
    rows = (host[row] for row in range(host.batch_shape[0])) if host.batch_shape else (host,)
    for scene in rows:  # most are without padding by now, and copying them would cost as much as some metrics
        yield scene if scene.agent_mask.all() and scene.lane_mask.all() else unpadded(scene)


def pool(ratios: Iterable[Ratios]) -> Ratios:
    """Sums of numerators and denominators; a metric that a scene does not name adds nothing."""
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
    """Their quotient, NaN over nothing."""
    return float(numerator / denominator) if denominator else math.nan


def intervals(
    scenes: Sequence[Ratios],
    clusters: Sequence[Hashable],
    summarise: Callable[[Ratios], Values] = values,
    *,
    draws: int = 1000,
    seed: int = 0,
    level: float = 0.95,
) -> dict[str, tuple[float, float]]:
    """Percentile bootstrap intervals of ``summarise(pool(scenes))``, drawing whole clusters with replacement.

    Scenes of one location are alike; drawing scenes would make the intervals too narrow (metrics.md, baselines.md).

    Args:
      scenes: contribution of every scene.
      clusters: location of every scene.
      summarise: pooled ratios -> values.
      draws: bootstrap samples.
      seed: of the draws.
      level: coverage.

    Returns:
      (low, high) per value, NaN where fewer than two clusters were given.

    Raises:
      ValueError: if scenes and clusters differ in number.
    """
    if len(scenes) != len(clusters):
        raise ValueError(f"{len(scenes)} scenes but {len(clusters)} clusters: name the location of every scene")
    total = pool(scenes)
    groups = {cluster: row for row, cluster in enumerate(dict.fromkeys(clusters))}
    if len(groups) < 2:
        return {name: (math.nan, math.nan) for name in summarise(total)}
    names = list(total)
    table = np.zeros((len(groups), len(names), 2))
    for scene, cluster in zip(scenes, clusters, strict=True):
        table[groups[cluster]] += np.array([scene.get(name, (0.0, 0.0)) for name in names])
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(len(groups), np.full(len(groups), 1 / len(groups)), draws)
    sums = np.einsum("dc,cnk->dnk", weights.astype(np.float64), table)
    drawn = [summarise({name: (float(p[0]), float(p[1])) for name, p in zip(names, s, strict=True)}) for s in sums]
    return {name: interval(np.array([draw[name] for draw in drawn]), level) for name in drawn[0]}


def interval(drawn: Float64[np.ndarray, " draws"], level: float = 0.95) -> tuple[float, float]:
    """The middle ``level`` of the draws that are finite; NaN without any."""
    held = drawn[np.isfinite(drawn)]
    if not len(held):
        return math.nan, math.nan
    low, high = np.quantile(held, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
