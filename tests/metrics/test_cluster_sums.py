"""Tallies: merging in any order, files, intervals that cover, floors that follow the known law."""

import numpy as np
import pytest

from scjax.metrics.cluster_sums import ClusterSums, group_of
from scjax.metrics.distances import histogram, mean_and_deviation, moments
from scjax.metrics.distributions import scene_sums, table
from tests.factories.traffic import random_traffic


@pytest.fixture(scope="module")
def cluster_sums():
    sums = ClusterSums()
    for seed in range(24):
        sums.add(scene_sums(random_traffic(seed)), f"place {seed // 3}")
    return sums


def same(first, second):
    assert first.clusters.keys() == second.clusters.keys()
    for cluster, sums in first.clusters.items():
        for name, value in sums.items():
            np.testing.assert_allclose(second.clusters[cluster][name], value, rtol=1e-12, err_msg=name)


def test_merge_ignores_shards_and_order(cluster_sums):
    parts = [ClusterSums() for _ in range(3)]
    for seed in np.random.default_rng(0).permutation(24):
        parts[seed % 3].add(scene_sums(random_traffic(int(seed))), f"place {seed // 3}")
    merge_stats = ClusterSums()
    for part in reversed(parts):
        merge_stats.merge(part)
    same(cluster_sums, merge_stats)
    assert cluster_sums.total["scenes"] == 24
    np.testing.assert_allclose(
        cluster_sums.total["speed"], sum(scene_sums(random_traffic(k))["speed"] for k in range(24))
    )


def test_arrays_round_trip(cluster_sums):
    same(cluster_sums, ClusterSums.from_arrays(cluster_sums.arrays()))
    assert ClusterSums.from_arrays(ClusterSums().arrays()).total == {}
    with pytest.raises(ValueError, match="format 7 instead of 1"):
        ClusterSums.from_arrays(cluster_sums.arrays() | {"format": np.array(7)})


def simple(values, clusters):
    sums = ClusterSums()
    for value, cluster in zip(values, clusters, strict=True):
        value = np.atleast_1d(value)
        sums.add({"x": moments(value), "h": histogram(value, -6.0, 6.0, 1.0)}, cluster)
    return sums


def rows(generated, real):
    mean = mean_and_deviation(generated["x"])[0]
    other = mean_and_deviation(real["x"])[0]
    return {"mean": mean, "frechet_mean": abs(mean - other)}


def test_intervals_cover_at_their_level():
    rng, hits = np.random.default_rng(0), 0
    for trial in range(120):
        places = rng.normal(0, 1, 40)
        samples = simple(places + rng.normal(0, 0.1, 40), [str(k) for k in range(40)])
        low, high = samples.intervals(samples, rows, draws=200, seed=trial)["mean"]
        hits += low <= 0 <= high
    assert 0.87 <= hits / 120 <= 1.0


def test_intervals_resample_whole_clusters():
    rng = np.random.default_rng(0)
    places = np.repeat(rng.normal(0, 1, 20), 10)
    alike = simple(places, [str(k // 10) for k in range(200)])
    independent = simple(places, [str(k) for k in range(200)])
    width = [np.ptp(side.intervals(side, rows)["mean"]) for side in (alike, independent)]
    assert width[0] > 2.0 * width[1]


def test_intervals_correct_the_bias_of_distances():
    rng = np.random.default_rng(1)
    first, second = (simple(rng.normal(shift, 1, 100), [str(k) for k in range(100)]) for shift in (0.0, 0.6))
    distance = rows(first.total, second.total)["frechet_mean"]
    low, high = first.intervals(second, rows)["frechet_mean"]
    assert 0 <= low < distance < high and abs((low + high) / 2 - distance) < 0.1


def test_floor_matches_its_closed_form():
    # The means of two halves of n values of deviation 1 differ by sqrt(2 / (n / 2)) times |N(0, 1)|: 0.8 of that.
    values = np.random.default_rng(0).normal(0, 1, 400)
    mean, low, high = simple(values, [str(k) for k in range(400)]).floor(rows)["frechet_mean"]
    assert mean == pytest.approx(0.8 * np.sqrt(4 / 400), rel=0.15) and low < mean < high
    with pytest.raises(ValueError, match="two locations"):
        simple(values[:3], ["a", "a", "a"]).floor(rows)


def test_intervals_are_nan_for_one_cluster(cluster_sums):
    one = simple(np.arange(4.0), list("aaaa"))
    assert np.isnan(one.intervals(one, rows)["mean"]).all()
    assert {group_of(k) for k in range(1000)} == {group_of(k) for k in range(200)}
    bounds = cluster_sums.intervals(cluster_sums, table, draws=20)
    assert all(low <= high for low, high in bounds.values() if np.isfinite(low))
