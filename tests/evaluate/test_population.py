"""Measuring populations in parts: shards, resumption, fingerprints."""

import numpy as np
import pytest

from scjax.evaluate.population import Population, measure_populations
from scjax.evaluate.sources import ChosenRows, open_source
from scjax.metrics.measure import match_values, measure
from tests.factories.evaluations import SCENES


@pytest.fixture
def population(worlds):
    """Scenes that answer the references in another order."""
    source = open_source(f"npz:{worlds}")
    return Population("shifted", ChosenRows(source, np.roll(np.arange(8), 1)), source, range(8))


def test_measure_populations_waits_for_other_shards(population, tmp_path):
    assert measure_populations([population], tmp_path, workers=0, shard=(0, 2), part_size=3) is None
    assert len(list(tmp_path.iterdir())) == 2


def test_measure_populations_keeps_measured_parts(population, tmp_path):
    measure_populations([population], tmp_path, workers=0, shard=(0, 2), part_size=3)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    measure_populations([population], tmp_path, workers=0, part_size=3)
    assert all(path.stat().st_mtime_ns == time for path, time in times.items())


def test_measure_populations_equals_one_pass(population, tmp_path):
    (stats,) = measure_populations([population], tmp_path, workers=0, part_size=3) or [None]
    whole = measure(np.roll(np.array(SCENES, object), 1).tolist(), population.references.clusters, SCENES)
    assert match_values(stats.cluster_sums.total) == pytest.approx(match_values(whole.cluster_sums.total))
    assert stats.clusters == whole.clusters


def test_population_fingerprint_depends_on_the_rows(population):
    other = Population("shifted", population.source, population.references, [*range(1, 8), 0])
    assert other.fingerprint != population.fingerprint
