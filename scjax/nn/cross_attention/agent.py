"""Agent attention (Han et al. 2023, arXiv:2312.08874; attention-variants §4.5): a few agent tokens read the context
for all queries, which then read the agents.

The original pools its agents from a grid of queries. Scene tokens come in an order, so that they are pooled in
segments of it; or the agents are learned, or gathered by learned seeds.
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
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, at_least, one_of, only, readers
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit
from scjax.scene.pytree import pytree

_TABLE = 7  # rows and columns of the coarse bias table


@dataclasses.dataclass(frozen=True)
class AgentOptions:
    """Options of ``Agent``.

    Attributes:
      tokens: agents; 0 chooses 49, the original's 7 x 7, or 32 up to a width of 256.
      pooling: "segment" averages the queries of equal parts of their order; "set" lets learned seeds attend to the
        queries; "learned" agents do not depend on them, so that what they read is encoded once a scene.
      grid_bias: whether each agent has a learned preference for places of an image.
    """

    tokens: int = 0
    pooling: Literal["segment", "learned", "set"] = "segment"
    grid_bias: bool = False
    empty_is_zero: ClassVar[bool] = True

    def __post_init__(self):
        at_least(self, tokens=0)
        one_of(self, pooling=("segment", "learned", "set"))


@pytree
class AgentValues:
    """What learned agents read of the context."""

    value: Float[Array, "b h agents d"]
    mask: Bool[Array, "b m"]


class Agent(Projections):
    """y = W_o Attn(Q, A, Attn(A, K, V)) with agents A in the space of the queries."""

    def __init__(
        self, options: AgentOptions, width: int, heads: int, spec: ContextSpec, *, init: ParamInit,
        compute: Compute = "float32",
    ):  # fmt: skip
        super().__init__(width, heads, init=init, compute=compute)
        tokens = options.tokens or (32 if width <= 256 else 49)
        self.agents = None if options.pooling == "segment" else nnx.Param(init.normal((tokens, width), 0.02))
        if options.grid_bias and spec.grid is None:
            raise ValueError(f"AgentOptions.grid_bias needs an image's grid, not {spec.kind} tokens: leave it out")
        self.bias = GridBias(heads * tokens, spec, init=init) if options.grid_bias else None
        self.options, self.tokens = options, tokens

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Keys | AgentValues:
        """Keys and values, or what learned agents make of them."""
        keys = self.project(context, mask)
        if self.options.pooling != "learned":
            return keys
        return AgentValues(value=self._gather(self._learned(len(mask)), keys), mask=mask)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Keys | AgentValues
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read of what the agents have read."""
        query = self.query(x, x_mask)
        if isinstance(cache, AgentValues):
            agents, values = self._learned(len(x)), cache.value
        else:
            if self.options.pooling == "segment":
                agents = segments(x_mask, self.tokens).astype(query.dtype) @ query
            else:
                agents = attend(self._learned(len(x)), query, query, x_mask[:, None], self.heads)
            values = self._gather(agents, cache)
        attended = merge_heads(
            attend_heads(split_heads(query, self.heads), split_heads(agents, self.heads), values, None)
        )
        return only(readers(x_mask, cache.mask), self.out(attended)), AuxOutputs()

    def _learned(self, scenes: int) -> Float[Array, "b agents d"]:
        assert self.agents is not None
        return jnp.broadcast_to(self.agents[...][None], (scenes, *self.agents.shape))

    def _gather(self, agents: Float[Array, "b agents d"], keys: Keys) -> Float[Array, "b h agents e"]:
        """Attn(A, K, V), with the bias of places if there is one."""
        if self.bias is None:
            return split_heads(self.read(agents, keys), self.heads)
        query = self.towards(agents)
        logits = query * query.shape[-1] ** -0.5 @ keys.key.swapaxes(2, 3)
        logits = logits + self.bias().reshape(1, self.heads, self.tokens, -1)
        p, total = weights(logits, keys.mask[:, None, None])
        return split_heads(self.offset(p.astype(logits.dtype) @ keys.value / total), self.heads)


class GridBias(nnx.Module):
    """A logit a row (head and agent) and cell: a coarse table, enlarged, and one a row and one a column of the grid."""

    def __init__(self, rows: int, spec: ContextSpec, *, init: ParamInit):
        assert spec.grid is not None
        self.coarse = nnx.Param(init.normal((rows, _TABLE, _TABLE), 0.02))
        self.rows = nnx.Param(init.normal((rows, spec.grid[0], 1), 0.02))
        self.columns = nnx.Param(init.normal((rows, 1, spec.grid[1]), 0.02))
        self.spec = spec

    def __call__(self) -> Float[Array, "rows m"]:
        """The same for all modalities."""
        assert self.spec.grid is not None
        coarse = self.coarse[...]
        bias = jax.image.resize(coarse, (len(coarse), *self.spec.grid), "linear", antialias=False)
        bias = bias + self.rows[...] + self.columns[...]
        return jnp.tile(bias.reshape(len(coarse), -1), (1, self.spec.modalities))


def segments(mask: Bool[Array, "b n"], parts: int) -> Float[Array, "b parts n"]:
    """Weights of the means over equal parts of the order of the valid tokens (adaptive average pooling).

    Part a of p covers the ranks floor(a n_b / p) .. ceil((a + 1) n_b / p) - 1 of n_b tokens: parts overlap where p does
    not divide n_b, and repeat tokens where p exceeds it. Zero without any token.
    """
    rank, count = jnp.cumsum(mask, -1)[:, None] - 1, mask.sum(-1)[:, None, None]
    part = jnp.arange(parts)[None, :, None]
    first, end = part * count // parts, ((part + 1) * count + parts - 1) // parts
    inside = mask[:, None] & (rank >= first) & (rank < end)
    return inside / jnp.maximum(end - first, 1)
