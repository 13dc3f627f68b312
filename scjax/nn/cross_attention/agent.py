"""Agent attention (Han et al. 2023, arXiv:2312.08874; attention-variants §4.5).

A few agent tokens attend to the context; the queries then attend to the agents. The original pools its agents from a
grid of queries. Scene tokens have an order, so here they are pooled in segments of that order. Alternatively the
agents are learned, or pooled by learned seeds.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.attention import attend, attend_heads, merge_heads, split_heads, weights
from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import (
    AuxOutputs,
    ContextSpec,
    CrossAttentionOptions,
    Work,
    active_rows,
    at_least,
    mask_rows,
    one_of,
)
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit
from scjax.scene.pytree import pytree

_COARSE_CELLS = 7  # rows and columns of the coarse bias table


@dataclasses.dataclass(frozen=True)
class AgentOptions(CrossAttentionOptions):
    """Options of ``Agent``.

    Attributes:
      tokens: number of agents; 0 chooses 49, the original's 7 x 7, or 32 up to a width of 256.
      pooling: "segment" averages the queries of equal parts of their order; "set" lets learned seeds attend to the
        queries; "learned" agents do not depend on the queries, so their values are encoded once per scene.
      grid_bias: whether each agent has a learned bias over the cells of an image.
    """

    name: ClassVar[str] = "agent"

    tokens: int = 0
    pooling: Literal["segment", "learned", "set"] = "segment"
    grid_bias: bool = False

    def __post_init__(self):
        at_least(self, tokens=0)
        one_of(self, pooling=("segment", "learned", "set"))

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> Agent:
        """The module of this mechanism."""
        return Agent(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        tokens = self.tokens or (32 if width <= 256 else 49)
        gather = 2 * tokens * context * width
        pool = {"segment": 1, "set": 2, "learned": 0}[self.pooling] * tokens * queries * width
        read = 2 * queries * width**2 + pool + 2 * queries * tokens * width
        project = 2 * context * width**2
        return Work(project + gather, read) if self.pooling == "learned" else Work(project, gather + read)


@pytree
class AgentValues:
    """What learned agents read from the context."""

    value: Float[Array, "b h agents d"]
    mask: Bool[Array, "b m"]


class Agent(Projections):
    """y = W_o Attn(Q, A, Attn(A, K, V)) with agents A in the space of the queries."""

    def __init__(
        self,
        options: AgentOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        super().__init__(width, heads, init=init, compute=compute)
        tokens = options.tokens or (32 if width <= 256 else 49)
        self.agents = None if options.pooling == "segment" else nnx.Param(init.normal((tokens, width), 0.02))
        if options.grid_bias and spec.grid is None:
            raise ValueError(f"AgentOptions.grid_bias needs an image's grid, not {spec.kind} tokens: leave it out")
        self.bias = GridBias(heads * tokens, spec, init=init) if options.grid_bias else None
        self.options, self.tokens = options, tokens

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Keys | AgentValues:
        """Keys and values, or the values of learned agents."""
        keys = self.project(context, mask)
        if self.options.pooling != "learned":
            return keys
        return AgentValues(value=self._agent_values(self._learned_agents(len(mask)), keys), mask=mask)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Keys | AgentValues
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read from the agents."""
        query = self.query(x, x_mask)
        if isinstance(cache, AgentValues):
            agents, values = self._learned_agents(len(x)), cache.value
        else:
            if self.options.pooling == "segment":
                agents = segment_weights(x_mask, self.tokens).astype(query.dtype) @ query
            else:
                agents = attend(self._learned_agents(len(x)), query, query, x_mask[:, None], self.heads)
            values = self._agent_values(agents, cache)
        attended = merge_heads(
            attend_heads(split_heads(query, self.heads), split_heads(agents, self.heads), values, None)
        )
        return mask_rows(active_rows(x_mask, cache.mask), self.out(attended)), AuxOutputs()

    def _learned_agents(self, scenes: int) -> Float[Array, "b agents d"]:
        assert self.agents is not None
        return jnp.broadcast_to(self.agents[...][None], (scenes, *self.agents.shape))

    def _agent_values(self, agents: Float[Array, "b agents d"], keys: Keys) -> Float[Array, "b h agents e"]:
        """Attn(A, K, V), with the grid bias if there is one."""
        if self.bias is None:
            return split_heads(self.read(agents, keys), self.heads)
        query = self.scaled_query(agents)
        logits = query * query.shape[-1] ** -0.5 @ keys.key.swapaxes(2, 3)
        logits = logits + self.bias().reshape(1, self.heads, self.tokens, -1)
        p, total = weights(logits, keys.mask[:, None, None])
        return split_heads(self.offset(p.astype(logits.dtype) @ keys.value / total), self.heads)


class GridBias(nnx.Module):
    """A logit per row (head and agent) and cell: a coarse table, upsampled, plus terms per grid row and column."""

    def __init__(self, rows: int, spec: ContextSpec, *, init: ParamInit):
        assert spec.grid is not None
        self.coarse = nnx.Param(init.normal((rows, _COARSE_CELLS, _COARSE_CELLS), 0.02))
        self.rows = nnx.Param(init.normal((rows, spec.grid[0], 1), 0.02))
        self.columns = nnx.Param(init.normal((rows, 1, spec.grid[1]), 0.02))
        self.spec = spec

    def __call__(self) -> Float[Array, "rows m"]:
        """Logits [rows, cells], the same for all modalities."""
        assert self.spec.grid is not None
        coarse = self.coarse[...]
        bias = jax.image.resize(coarse, (len(coarse), *self.spec.grid), "linear", antialias=False)
        bias = bias + self.rows[...] + self.columns[...]
        return jnp.tile(bias.reshape(len(coarse), -1), (1, self.spec.modalities))


def segment_weights(mask: Bool[Array, "b n"], parts: int) -> Float[Array, "b parts n"]:
    """Weights of the means over equal parts of the order of the valid tokens (adaptive average pooling).

    Part a of p covers the ranks floor(a n_b / p) .. ceil((a + 1) n_b / p) - 1 of n_b tokens: parts overlap where p does
    not divide n_b, and repeat tokens where p exceeds it. Zero without any token.
    """
    rank, count = jnp.cumsum(mask, -1)[:, None] - 1, mask.sum(-1)[:, None, None]
    part = jnp.arange(parts)[None, :, None]
    first, end = part * count // parts, ((part + 1) * count + parts - 1) // parts
    inside = mask[:, None] & (rank >= first) & (rank < end)
    return inside / jnp.maximum(end - first, 1)
