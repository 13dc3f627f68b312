"""Probabilities of lane and agent counts: from the condition where the model has learned them, else from its data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from scjax.generate.conditions import Stream
from scjax.generate.model import Model
from scjax.generate.outline_draw import Outline
from scjax.generate.scene_spec import AGENT_COUNTS, SceneSpec
from scjax.language.attributes.vector import request_vector
from scjax.models.counts.on_host import count_log_probabilities
from scjax.models.counts.predictor import CountPredictorConfig
from scjax.models.counts.prior import Table, draw_counts
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

    def draw(self, rng: np.random.Generator, spec: SceneSpec, outline: Outline | None) -> tuple[int, int, int]:
        """The domain and the numbers of lanes and agents of a scene, where neither spec nor outline says them."""
        domain, num_lanes, num_agents = spec.domain, spec.num_lanes, spec.num_agents
        known_agents, known_lanes = spec.known_counts
        most, least = self._model.denoiser.config.max_agents, known_agents
        if self.read_attributes:
            least = min(max(least, least_agents(spec.attributes)), most)
        elif num_agents is None and (usual := usual_agents(spec.attributes)) is not None:
            num_agents = min(max(usual, known_agents, 1), most)
        if outline is not None:
            domain, num_agents = outline.domain, len(outline.agents)
            num_lanes = num_lanes if outline.num_lanes is None else outline.num_lanes
        return draw_counts(
            rng,
            self(spec.streams.get("text"), spec.attributes, spec.domain, spec.crop),
            spec.crop,
            domain=domain,
            num_lanes=num_lanes,
            num_agents=num_agents,
            least_lanes=known_lanes,
            least_agents=least,
        )

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


def usual_agents(attributes: Mapping[str, Any]) -> int | None:
    """Agents with the ego by the attributes, if these give the vehicles, else None.

    The number is the middle of each range, or its lower end where the upper one is open.
    """
    if "vehicles" not in attributes:
        return None
    ranges = [attributes[name] for name in AGENT_COUNTS if name in attributes]
    return 1 + sum(int(low if high is None else (low + high) // 2) for low, high in ranges)


def least_agents(attributes: Mapping[str, Any]) -> int:
    """Agents that the attributes request at least, the ego included."""
    return 1 + sum(int(attributes.get(name, (0, None))[0]) for name in (*AGENT_COUNTS, "static"))


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
