"""Probabilities of lane and agent counts: from the prompt where the model has learned them, else from its data."""

from __future__ import annotations

import numpy as np

from scjax.generate.conditions import Stream
from scjax.generate.model import Model
from scjax.models.counts.on_host import count_log_probabilities
from scjax.models.counts.predictor import CountPredictorConfig
from scjax.models.counts.prior import Table
from scjax.scene import Crop


class CountTables:
    """Count tables for the requests of one call; each text is evaluated once."""

    def __init__(self, model: Model):
        self._model = model
        self._tables: dict[tuple[bytes, int | None], Table] = {}

    def __call__(self, text: Stream | None, domain: int | None, crop: Crop) -> Table | None:
        """Probabilities [domains, crops, lanes, agents]; None if the model has none.

        The count predictor was trained on centered scenes: it says nothing about those ahead of the ego.
        """
        if text is None or "count_predictor" not in self._model.components or crop == Crop.FORWARD:
            return self._model.counts
        cache_key = text.content_hash(), domain
        if cache_key not in self._tables:
            self._tables[cache_key] = _predicted_table(text, domain, self._model)
        return self._tables[cache_key]


def _predicted_table(text: Stream, domain: int | None, model: Model) -> Table:
    network = model.count_predictor
    config: CountPredictorConfig = network.config
    tokens = np.asarray(text.tokens) if text.mask is None else np.asarray(text.tokens)[np.asarray(text.mask)]
    logits = count_log_probabilities(config, network.params, tokens, config.domains if domain is None else domain)
    logits = logits.astype(np.float64)
    weights = np.exp(config.sharpness * (logits - logits.max()))
    table = np.broadcast_to(weights / weights.sum(), (1, len(Crop), *weights.shape))
    shares = np.ones(config.domains) if model.counts is None else model.counts.sum((1, 2, 3))
    return (shares / shares.sum())[:, None, None, None] * table
