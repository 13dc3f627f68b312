"""Ratios pool by sums, whatever the batching; intervals draw clusters."""

import math

import numpy as np
import pytest

from scjax.metrics.pooling import intervals, pool, singles, values
from scjax.scene import pad, stack
from tests.factories.traffic import agent, crossing, scene


def test_pool_weights_scenes_by_denominator():
    pooled = pool([{"a": (1.0, 4.0)}, {"a": (5.0, 8.0), "b": (0.0, 0.0)}])
    assert pooled == {"a": (6.0, 12.0), "b": (0.0, 0.0)}
    assert values(pooled)["a"] == 0.5 and math.isnan(values(pooled)["b"])


def test_singles_flattens_batches_and_drops_padding():
    one, other = crossing(), scene([agent(0, 0)])
    batch = stack([one, other])
    for scenes in (batch, [one, other], iter([pad(one, 9, 9), other]), [batch]):
        results = list(singles(scenes))
        assert [len(s.agent_mask) for s in results] == [4, 1] and all(s.agent_mask.all() for s in results)
    np.testing.assert_array_equal(next(singles(one)).agents, one.agents)
    with pytest.raises(ValueError, match="flatten"):
        list(singles(stack([one, one]).replace(agent_mask=np.ones((2, 2, 4), bool))))


def test_intervals_cover_and_depend_on_clusters():
    rng = np.random.default_rng(0)
    hits = 0
    for trial in range(60):
        means = rng.normal(size=40)
        scenes = [{"m": (mean, 1.0)} for mean in np.repeat(means, 5)]
        low, high = intervals(scenes, np.repeat(np.arange(40), 5).tolist(), draws=200, seed=trial)["m"]
        hits += low <= 0 <= high
        assert 0.3 < high - low < 1.0  # 4 / sqrt(40), not 4 / sqrt(200)
    assert hits >= 50


def test_intervals_need_two_clusters():
    scenes = [{"m": (1.0, 1.0)}, {"m": (0.0, 1.0)}]
    assert all(math.isnan(bound) for bound in intervals(scenes, ["a", "a"])["m"])
    with pytest.raises(ValueError, match="2 scenes but 1 clusters"):
        intervals(scenes, ["a"])
