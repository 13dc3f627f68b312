"""f_count: the numbers of lanes and agents for a condition, as a joint distribution over (N_l, N_o).

The paper predicts counts from condition tokens by attention; its release has no such network (official-spec §8). This
network gives probabilities, so counts can be sampled and restricted to known bounds. Its condition is a text, or a
request for attributes, whose vector is one token.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float, Int

from scjax.models.denoiser.context import TextFeatures
from scjax.nn.attention import attend
from scjax.nn.functional import Functional, functional
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear

_STD = 0.02
NEVER = -1e9
"""Logit of zero lanes and of zero agents."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class CountPredictorConfig:
    """Sizes of the network.

    Attributes:
      text_width: features per token.
      attributes: names of the features of a request (``language.attributes.vector``); () where it reads texts.
      domains: number of domain labels.
      width: hidden width per query.
      queries, heads: learned queries that read the tokens, and their attention heads.
      max_lanes, max_agents: largest counts.
      sharpness: inverse temperature of sampled counts: the power to which probabilities are raised.
    """

    text_width: int
    attributes: tuple[str, ...] = ()
    domains: int
    width: int = 128
    queries: int = 4
    heads: int = 4
    max_lanes: int = 100
    max_agents: int = 61
    sharpness: float = 1.0

    def __post_init__(self):
        for field in dataclasses.fields(self):
            if field.name != "attributes" and getattr(self, field.name) < 1:
                raise ValueError(
                    f"CountPredictorConfig.{field.name} must be at least 1, not {getattr(self, field.name)}"
                )
        if self.attributes and len(self.attributes) != self.text_width:
            raise ValueError(
                f"CountPredictorConfig has {len(self.attributes)} attributes, but text_width {self.text_width}: give "
                "as many"
            )
        if self.width % self.heads:
            raise ValueError(f"CountPredictorConfig.width {self.width} must be a multiple of heads {self.heads}")

    @classmethod
    def from_json(cls, fields: dict[str, Any]) -> CountPredictorConfig:
        """The config with the fields of a JSON document."""
        return cls(**{**fields, "attributes": tuple(fields.get("attributes", ()))})


class CountPredictor(nnx.Module):
    """Learned queries attend to the tokens. Lanes follow from the result, agents from it and the number of lanes."""

    def __init__(self, config: CountPredictorConfig, *, init: ParamInit):
        width, inner = config.width, config.width * config.queries

        def table(rows: int, size: int) -> nnx.Param:
            return nnx.Param(init.normal((rows, size), _STD))

        self.token_in, self.token_norm = Linear(config.text_width, width, init=init), LayerNorm(width)
        self.query = table(config.queries, width)
        self.key, self.value = Linear(width, width, init=init), Linear(width, width, init=init)
        self.domains = table(config.domains + 1, inner)  # the last row: unknown domain
        self.hidden, self.norm = Linear(inner, inner, init=init), LayerNorm(inner)
        self.lanes = Linear(inner, config.max_lanes + 1, init=init, std=_STD)
        self.known_lanes = table(config.max_lanes + 1, inner)
        self.agents_hidden = Linear(inner, inner, init=init)
        self.agents = Linear(inner, config.max_agents + 1, init=init, std=_STD)
        self.config = config

    def __call__(self, text: TextFeatures, domain: Int[Array, " b"]) -> Float[Array, "b lanes agents"]:
        """log P(N_l, N_o), one table per prompt; P sums to one over counts of at least one.

        Args:
          text: token features of the prompts.
          domain: label, or ``config.domains`` for an unknown domain.
        """
        mask: Bool[Array, "b n"] = jnp.asarray(text.mask)
        tokens = jnp.where(mask[..., None], jnp.asarray(text.tokens), 0)
        tokens = self.token_norm(jax.nn.gelu(self.token_in(tokens)))
        query = jnp.broadcast_to(self.query[...][None], (len(mask), *self.query.shape))
        read = attend(query, self.key(tokens), self.value(tokens), mask[:, None], self.config.heads)
        hidden = read.reshape(len(mask), -1) + self.domains[...][domain]
        hidden = self.norm(hidden + jax.nn.gelu(self.hidden(hidden)))
        lanes = _log_softmax(self.lanes(hidden))
        inner = jax.nn.gelu(self.agents_hidden(hidden)[:, None] + self.known_lanes[...][None])
        return lanes[..., None] + _log_softmax(self.agents(inner))


def count_loss(
    tables: Float[Array, "b lanes agents"], num_lanes: Int[Array, " b"], num_agents: Int[Array, " b"]
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Mean of -log P of the true counts, and the mean absolute errors of the expected counts."""
    log_probability = tables[jnp.arange(len(tables)), num_lanes, num_agents]
    shares = jnp.exp(tables)
    lanes = (shares.sum(2) * jnp.arange(tables.shape[1])[None]).sum(1)
    agents = (shares.sum(1) * jnp.arange(tables.shape[2])[None]).sum(1)
    errors = {"lanes_mae": jnp.abs(lanes - num_lanes).mean(), "agents_mae": jnp.abs(agents - num_agents).mean()}
    return -log_probability.mean(), {"total": -log_probability.mean(), **errors}


@functools.lru_cache(maxsize=8)
def count_predictor(config: CountPredictorConfig) -> Functional:
    """The network as pure functions."""
    return functional(lambda init: CountPredictor(config, init=init))


def _log_softmax(logits: Float[Array, "*b n"]) -> Float[Array, "*b n"]:
    none = jnp.where(jnp.arange(logits.shape[-1]) == 0, NEVER, 0.0).reshape((1,) * (logits.ndim - 1) + (-1,))
    return jax.nn.log_softmax(logits + none)
