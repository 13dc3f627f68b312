"""Probabilities of lane and agent counts: from the condition where the model has learned them, else from its data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from scjax.generate.conditions import Stream
from scjax.generate.model import Model
from scjax.language.attributes.vector import request_vector
from scjax.models.counts.on_host import count_log_probabilities
from scjax.models.counts.predictor import CountPredictorConfig
from scjax.models.counts.prior import Table
from scjax.scene import Crop


class CountTables:
    """Count tables for the requests of one call; each condition is evaluated once."""

    def __init__(self, model: Model):
        self._model = model
        self._tables: dict[tuple[bytes, int | None], Table] = {}

    @property
    def read_attributes(self) -> bool:
        """Whether the model predicts counts from a request for attributes."""
        components = self._model.components
        return "count_predictor" in components and bool(self._model.count_predictor.config.attributes)

    def __call__(
        self, text: Stream | None, attributes: Mapping[str, Any], domain: int | None, crop: Crop
    ) -> Table | None:
        """Probabilities [domains, crops, lanes, agents]; None if the model has none.

        The count predictor was trained on centered scenes: it says nothing about those ahead of the ego.
        """
        if "count_predictor" not in self._model.components or crop == Crop.FORWARD:
            return self._model.counts
        names = self._model.count_predictor.config.attributes
        tokens = request_vector(attributes, names)[None] if names else _real_tokens(text)
        if tokens is None or not tokens.any():
            return self._model.counts
        cache_key = tokens.tobytes(), domain
        if cache_key not in self._tables:
            self._tables[cache_key] = _predicted_table(tokens, domain, self._model)
        return self._tables[cache_key]


def _real_tokens(text: Stream | None) -> Float[np.ndarray, "tokens width"] | None:
    if text is None:
        return None
    return np.asarray(text.tokens) if text.mask is None else np.asarray(text.tokens)[np.asarray(text.mask)]


def _predicted_table(tokens: Float[np.ndarray, "tokens width"], domain: int | None, model: Model) -> Table:
    network = model.count_predictor
    config: CountPredictorConfig = network.config
    logits = count_log_probabilities(config, network.params, tokens, config.domains if domain is None else domain)
    logits = logits.astype(np.float64)
    weights = np.exp(config.sharpness * (logits - logits.max()))
    table = np.broadcast_to(weights / weights.sum(), (1, len(Crop), *weights.shape))
    shares = np.ones(config.domains) if model.counts is None else model.counts.sum((1, 2, 3))
    return (shares / shares.sum())[:, None, None, None] * table
