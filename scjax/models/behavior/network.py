"""The behavior network: surroundings of agents -> their returns, and their motions given a return.

Each agent reads its neighbors by attention. It first gives the distribution of its return, then, once a return is
chosen, that of its next motion token, as CtRL-Sim (Rowe et al., CoRL 2024) does.
"""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float, Int

from scjax.models.behavior.config import CLASSES, BehaviorConfig
from scjax.models.behavior.surroundings import sizes_of
from scjax.nn.attention import weights
from scjax.nn.functional import Functional, functional
from scjax.nn.init import ParamInit
from scjax.nn.layers import LayerNorm, Linear

_STD = 0.02


class _Mlp(nnx.Module):
    """Linear layers with GELU between them."""

    def __init__(self, *sizes: int, init: ParamInit, std: float | None = None):
        last = len(sizes) - 2
        self.linears = nnx.List(
            [
                Linear(i, o, init=init, std=std if n == last else None)
                for n, (i, o) in enumerate(itertools.pairwise(sizes))
            ]
        )

    def __call__(self, x: Float[Array, "*b i"]) -> Float[Array, "*b o"]:
        first, *rest = self.linears
        x = first(x)
        for linear in rest:
            x = linear(jax.nn.gelu(x))
        return x


class _Block(nnx.Module):
    """Attention of each agent to its neighbors, and a feed-forward layer; both residual, norm first."""

    def __init__(self, config: BehaviorConfig, *, init: ParamInit):
        width = config.width
        self.norm, self.mlp_norm = LayerNorm(width), LayerNorm(width)
        self.query, self.key = Linear(width, width, init=init), Linear(width, width, init=init)
        self.value, self.out = Linear(width, width, init=init), Linear(width, width, init=init, std=_STD)
        self.mlp = _Mlp(width, 2 * width, width, init=init, std=_STD)
        self.heads = config.heads

    def __call__(
        self, agent: Float[Array, "m d"], others: Float[Array, "m k d"], mask: Bool[Array, "m k"]
    ) -> Float[Array, "m d"]:
        query = self.query(self.norm(agent))
        key, value = self.key(others), self.value(others)
        shape = (*key.shape[:2], self.heads, -1)
        # One query a row: sums of products are faster on CPUs than many tiny matrix products.
        key, value, query = key.reshape(shape), value.reshape(shape), query.reshape(len(query), 1, self.heads, -1)
        logits = (key * query).sum(-1) * key.shape[-1] ** -0.5
        shares, total = weights(logits.swapaxes(1, 2), mask[:, None])
        shares = (shares / total).swapaxes(1, 2)
        read = (shares[..., None] * value).sum(1).reshape(agent.shape)
        agent = agent + self.out(read)
        return agent + self.mlp(self.mlp_norm(agent))


class BehaviorNetwork(nnx.Module):
    """See the module; its methods work on rows of agents, of whatever scenes."""

    def __init__(self, config: BehaviorConfig, *, init: ParamInit):
        own, others = sizes_of(config)
        width = config.width
        self.own_in = _Mlp(own, 2 * width, width, init=init)
        self.others_in, self.others_norm = _Mlp(others, width, width, init=init), LayerNorm(width)
        self.blocks = nnx.List([_Block(config, init=init) for _ in range(config.layers)])
        self.norm = LayerNorm(width)
        self.returns_out = _Mlp(width, width, config.returns, init=init, std=_STD)
        self.return_in = nnx.Param(init.normal((config.returns, width), _STD))
        self.motions_out = _Mlp(width, 2 * width, CLASSES * config.motions, init=init, std=_STD)
        self.config = config

    def read(
        self, own: Float[Array, "m f"], others: Float[Array, "m k g"], mask: Bool[Array, "m k"]
    ) -> Float[Array, "m d"]:
        """What each agent knows, from ``Surroundings``."""
        agent = self.own_in(own)
        tokens = self.others_norm(self.others_in(others))
        for block in self.blocks:
            agent = block(agent, tokens, mask)
        return self.norm(agent)

    def returns(self, agent: Float[Array, "m d"]) -> Float[Array, "m r"]:
        """Logits of the return."""
        return self.returns_out(agent)

    def motions(
        self, agent: Float[Array, "m d"], returns: Int[Array, " m"], kind: Int[Array, " m"]
    ) -> Float[Array, "m v"]:
        """Logits of the next motion token, given the bin of the return."""
        hidden = agent + self.return_in[...][returns]
        logits = self.motions_out(hidden).reshape(len(agent), CLASSES, -1)
        row = jnp.clip(kind, 0, CLASSES - 1)[:, None, None]
        return jnp.take_along_axis(logits, row, axis=1)[:, 0]

    def __call__(
        self,
        own: Float[Array, "m f"],
        others: Float[Array, "m k g"],
        mask: Bool[Array, "m k"],
        returns: Int[Array, " m"],
        kind: Int[Array, " m"],
    ) -> tuple[Float[Array, "m r"], Float[Array, "m v"]]:
        """Logits of the return, and of the motion given the return."""
        agent = self.read(own, others, mask)
        return self.returns(agent), self.motions(agent, returns, kind)


@functools.lru_cache(maxsize=8)
def behavior_network(config: BehaviorConfig) -> Functional:
    """The network as pure functions."""
    return functional(lambda init: BehaviorNetwork(config, init=init))
