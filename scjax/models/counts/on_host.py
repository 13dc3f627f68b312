"""The count predictor in NumPy, for one prompt: on the host it costs less than compiling it for JAX."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from scjax.models.counts.predictor import NEVER, CountPredictorConfig
from scjax.nn.layers import EPS

Array = Float[np.ndarray, "..."]


def count_log_probabilities(
    config: CountPredictorConfig, params: Mapping[str, Any], tokens: Float[np.ndarray, "n f"], domain: int
) -> Float[np.ndarray, "lanes agents"]:
    """log P(N_l, N_o) of one prompt, as ``CountPredictor``.

    Args:
      tokens: features of the prompt's real tokens.
      domain: label, or ``config.domains`` for an unknown domain.
    """

    def linear(name: str, x: Array) -> Array:
        return x @ np.asarray(params[name]["kernel"]) + np.asarray(params[name]["bias"])

    def norm(name: str, x: Array) -> Array:
        x = x - x.mean(-1, keepdims=True)
        x = x / np.sqrt(np.square(x).mean(-1, keepdims=True) + EPS)
        return x * np.asarray(params[name]["scale"]) + np.asarray(params[name]["bias"])

    def heads(x: Array) -> Array:
        return x.reshape(len(x), config.heads, -1).swapaxes(0, 1)

    query, read = heads(np.asarray(params["query"])), 0.0
    if len(tokens):
        tokens = norm("token_norm", _gelu(linear("token_in", np.asarray(tokens, np.float32))))
        key, value = heads(linear("key", tokens)), heads(linear("value", tokens))
        read = np.exp(_log_softmax(query @ key.swapaxes(1, 2) * query.shape[-1] ** -0.5)) @ value
    read = np.broadcast_to(read, query.shape)
    hidden = read.swapaxes(0, 1).reshape(-1) + np.asarray(params["domains"])[domain]
    hidden = norm("norm", hidden + _gelu(linear("hidden", hidden)))
    inner = _gelu(linear("agents_hidden", hidden)[None] + np.asarray(params["known_lanes"]))
    lanes, agents = (_log_softmax(_without_zero(x)) for x in (linear("lanes", hidden), linear("agents", inner)))
    return lanes[:, None] + agents


def _gelu(x: Array) -> Array:
    return 0.5 * x * (1 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3)))


def _log_softmax(x: Array) -> Array:
    x = x - x.max(-1, keepdims=True)
    return x - np.log(np.exp(x).sum(-1, keepdims=True))


def _without_zero(logits: Array) -> Array:
    return np.concatenate([logits[..., :1] + NEVER, logits[..., 1:]], -1)
