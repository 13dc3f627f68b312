"""Probabilities of lane and agent counts: from the prompt where the model has learned them, else from its data."""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from scjax.generate.conditions import Stream
from scjax.generate.encode import text_features
from scjax.generate.model import Model
from scjax.models.counts.predictor import CountPredictorConfig, count_predictor
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
    features = text_features([text], len(text.tokens), config.text_width)
    label = jnp.array([config.domains if domain is None else domain])
    logits = np.asarray(_count_program(config)(network.params, features, label)[0], np.float64)
    weights = np.exp(config.sharpness * (logits - logits.max()))
    table = np.broadcast_to(weights / weights.sum(), (1, len(Crop), *weights.shape))
    shares = np.ones(config.domains) if model.counts is None else model.counts.sum((1, 2, 3))
    return (shares / shares.sum())[:, None, None, None] * table


@functools.lru_cache(maxsize=4)
def _count_program(config: CountPredictorConfig) -> Callable[..., Array]:
    return jax.jit(count_predictor(config).apply)
