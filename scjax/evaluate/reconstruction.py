"""Errors of an autoencoder on scenes that it decoded, element by element."""

from __future__ import annotations

from collections.abc import Mapping

from scjax.data.loader import clip_counts
from scjax.evaluate.generated import Made
from scjax.evaluate.population import Population
from scjax.evaluate.sources import BUCKET
from scjax.evaluate.tables import Number, Row, Section
from scjax.generate.model import Model
from scjax.metrics import reconstruction
from scjax.metrics.pooling import intervals, pool

NOTE = (
    "Encoded and decoded from the posterior mean, elements matched by index. The ego is left out of agent centre, z "
    "and heading. Metres, degrees, m/s; F1 of links that join lanes, and of neighbours."
)


def reconstruction_section(rows: Mapping[str, Population], models: Mapping[str, Model]) -> Section:
    """Of the rows that a model decoded; of each reference once."""
    made = {}
    for name, population in rows.items():
        model = models.get(getattr(population.source, "decoded_by", ""))
        if model is None or population.references is None or not isinstance(population.source, Made):
            continue
        chosen = range(min(len(population), len(population.references.clusters)))
        true = [
            clip_counts(model.codec.select(scene), BUCKET)
            for scene in population.references.read([population.rows[row] for row in chosen])
        ]
        pairs = zip(true, population.source.read(chosen), strict=True)
        errors = [reconstruction.reconstruction_errors(*pair) for pair in pairs]
        clusters = population.clusters(0, len(chosen))
        values = reconstruction.error_summary(pool(errors))
        bounds = intervals(errors, clusters, reconstruction.error_summary)
        numbers = {metric: Number(value, *bounds[metric]) for metric, value in values.items()}
        made[name] = Row(numbers, len(chosen), len(set(clusters)))
    return Section("Reconstruction", NOTE, made)
