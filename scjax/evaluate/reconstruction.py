"""Table of the reconstruction errors of autoencoders."""

from __future__ import annotations

from collections.abc import Mapping

from scjax.data.loader import clip_counts
from scjax.evaluate.generated import GeneratedScenes
from scjax.evaluate.population import Population
from scjax.evaluate.sources import LARGEST_COUNTS
from scjax.evaluate.tables import Number, Row, Section
from scjax.generate.model import Model
from scjax.metrics.pooling import intervals, pool
from scjax.metrics.reconstruction import error_summary, reconstruction_errors

NOTE = (
    "Encoded and decoded from the posterior mean; elements are matched by index. The ego is left out of agent "
    "center, z "
    "and heading. Units: metres, degrees, m/s; F1 of links between successive lanes and between neighbors."
)


def reconstruction_section(methods: Mapping[str, Population], models: Mapping[str, Model]) -> Section:
    """Errors of the methods with the request "reconstruction"; each reference counts once."""
    table_rows = {}
    for name, population in methods.items():
        source = population.source
        model = models.get(source.reconstructed_by) if isinstance(source, GeneratedScenes) else None
        if model is None or population.references is None:
            continue
        rows = range(min(len(population), len(population.references.clusters)))
        references = population.references.read([population.rows[row] for row in rows])
        true = [clip_counts(model.codec.select(scene), LARGEST_COUNTS) for scene in references]
        errors = [reconstruction_errors(*pair) for pair in zip(true, source.read(rows), strict=True)]
        clusters = population.clusters(0, len(rows))
        values, bounds = error_summary(pool(errors)), intervals(errors, clusters, error_summary)
        numbers = {metric: Number(value, *bounds[metric]) for metric, value in values.items()}
        table_rows[name] = Row(numbers, len(rows), len(set(clusters)))
    return Section("Reconstruction", NOTE, table_rows)
