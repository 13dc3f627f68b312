"""The layers of encoder and decoder: graph attention, edge update, and the factorized block (official-spec §2.1).

A ``trace`` dict receives every intermediate array under its name in the parity set; without one only the result is
computed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.models.autoencoder.edges import DenseEdges, Edges, pair_rstd
from scjax.nn.attention import attend, split_heads, weights
from scjax.nn.cpu import matmul as cpu_matmul
from scjax.nn.cpu.blockwise import blockwise_map
from scjax.nn.cpu.precision import Compute, matmul
from scjax.nn.init import ParamInit
from scjax.nn.layers import EPS, LayerNorm, Linear, ResidualMLP, subtract_mean
from scjax.scene.per_type import PerType

Trace = dict[str, Any] | None


class PairMasks(NamedTuple):
    """Which pairs may interact, True = yes; rows are destinations, columns sources."""

    lane_lane: Bool[Array, "b l l"]
    agent_lane: Bool[Array, "b a l"]
    agent_agent: Bool[Array, "b a a"]


def pair_masks(mask: PerType, behind: PerType | None = None) -> PairMasks:
    """All pairs of real nodes; with ``behind`` only pairs on the same side of the partition."""

    def pairs(destination: str, source: str):
        rows, columns = getattr(mask, destination)[:, :, None], getattr(mask, source)[:, None]
        if behind is None:
            return rows & columns
        return rows & columns & (getattr(behind, destination)[:, :, None] == getattr(behind, source)[:, None])

    return PairMasks(pairs("lanes", "lanes"), pairs("agents", "lanes"), pairs("agents", "agents"))


class GraphAttention(nnx.Module):
    """Gated attention and a feed-forward layer, both normalized before and after; edges add to keys and values."""

    def __init__(
        self, width: int, heads: int, ff: int, *, init: ParamInit, edge_width: int | None = None, compute: Compute
    ):
        def linear(features_in: int, features_out: int, bias: bool = True) -> Linear:
            return Linear(features_in, features_out, init=init, bias=bias, compute=compute)

        self.norm = LayerNorm(width)
        self.query, self.key, self.value = linear(width, width), linear(width, width, bias=False), linear(width, width)
        self.edge_norm = None if edge_width is None else LayerNorm(edge_width)
        self.edge_key = None if edge_width is None else linear(edge_width, width, bias=False)
        self.edge_value = None if edge_width is None else linear(edge_width, width)
        self.gate, self.skip, self.out = linear(2 * width, width), linear(width, width), linear(width, width)
        self.out_norm = LayerNorm(width)
        self.ff_norm, self.ff_in, self.ff_out = LayerNorm(width), linear(width, ff), linear(ff, width)
        self.ff_out_norm = LayerNorm(width)
        self.heads = heads

    def __call__(
        self,
        x: Float[Array, "b n d"],
        mask: Bool[Array, "b n m"],
        sources: Float[Array, "b m d"] | None = None,
        edges: Edges | None = None,
        trace: Trace = None,
    ) -> Float[Array, "b n d"]:
        """The updated x. ``sources`` defaults to x itself; a row without admitted sources aggregates zero."""
        own = self.norm(x)
        read = own if sources is None else self.norm(sources)
        q, k, v = self.query(own), self.key(read), self.value(read)
        m = attend(q, k, v, mask, self.heads) if edges is None else self._attend_with_edges(q, k, v, mask, edges)
        gate = jax.nn.sigmoid(self.gate(jnp.concatenate([m, own], -1)))
        u = m + gate * (self.skip(own) - m)
        out = self.out(u)
        x = x + self.out_norm(out)
        x = x + self.ff_out_norm(self.ff_out(jax.nn.relu(self.ff_in(self.ff_norm(x)))))
        if trace is not None:
            trace.update(xhat=own, q=q, k=k, v=v, m=m, g=gate, u=u, attn=out, y=x)
        return x

    def _attend_with_edges(self, q: Array, k: Array, v: Array, mask: Array, edges: Edges) -> Array:
        """Keys k_j + W_k r_ij and values v_j + W_v r_ij + b with r = LN(edge), without any array [B, L, L, width].

        q_i . W_k r_ij = (W_k' q_i) . r_ij, and sum_j a_ij W_v r_ij = W_v (sum_j a_ij r_ij). Of the norm's affine
        r = s z + t, the key side keeps s (t adds the same to all logits of a row), the value side both.
        """
        assert self.edge_norm is not None and self.edge_key is not None and self.edge_value is not None
        scale, offset = self.edge_norm.scale[...], self.edge_norm.bias[...]
        split = (scale.shape[0], self.heads, -1)
        queries = split_heads(q, self.heads) * (q.shape[-1] // self.heads) ** -0.5
        towards = jnp.einsum("bhid,chd->bihc", queries, self.edge_key.kernel[...].reshape(split))
        towards = towards * scale[None, None, None]
        logits = jnp.einsum("bhid,bhjd->bihj", queries, split_heads(k, self.heads))

        def mix(scene, rows):
            towards, logits, mask, own = rows
            edges = kind(own, *scene)
            p, total = weights(logits + edges.scores(towards), mask[:, :, None])
            p = p / total
            return p, edges.gather(p)

        kind, (own, *scene) = type(edges), edges
        args = tuple(scene), (towards, logits, mask, own)
        # Only dense edges are large enough to be processed in blocks.
        dense = isinstance(edges, DenseEdges)
        p, r = blockwise_map(mix, *args, mask.any(-1), mask.shape[2]) if dense else jax.checkpoint(mix)(*args)
        m = jnp.einsum("bihj,bhjd->bihd", p, split_heads(v, self.heads))
        r = r * scale[None, None, None] + offset[None, None, None]
        assert self.edge_value.bias is not None
        m = m + jnp.einsum("bihc,chd->bihd", r, self.edge_value.kernel[...].reshape(split))
        m = m.reshape(*m.shape[:-2], -1) + self.edge_value.bias[...][None, None]
        return jnp.where(mask.any(-1)[..., None], m, 0.0)


class EdgeUpdate(nnx.Module):
    """c_ij <- MLP([n_ij; c_ij]) with n_ij = MLP([e_i; e_j]), destination i first. No residual."""

    def __init__(self, node_width: int, edge_width: int, *, init: ParamInit, compute: Compute):
        self.nodes = ResidualMLP(2 * node_width, edge_width, init=init, compute=compute)
        self.edges = ResidualMLP(2 * edge_width, edge_width, init=init, compute=compute)

    def __call__(
        self,
        e: Float[Array, "b l d"],
        edges: Edges,
        real: Bool[Array, "b l"],
        then: Callable[[Array], Any] | None = None,
    ) -> Any:
        """``then(new values)``, or the new values [B, L, L, C]; arbitrary finite values where a lane is not real.

        ``then`` is applied block by block, so the new values never exist as a whole.
        """
        # The first products of the node MLP are sums of one of the destination and one of the source.
        first_own, first_other = _pair_products(self.nodes.linears[0], e)
        skip_own, skip_other = _pair_products(self.nodes.skip, e)
        entry = _mean_free_kernels(self.edges.linears[0], self.edges.skip)
        second = _mean_free_kernels(self.nodes.linears[1])
        width = second[0].shape[0]

        def update(scene, rows):
            first_other, skip_other, *scene = scene
            first_own, skip_own, own = rows
            edges = kind(own, *scene)
            hidden = jax.nn.relu(_pair_norm(self.nodes.norms[0], first_own, first_other))
            hidden = _norm(self.nodes.norms[1], cpu_matmul.linear(hidden, *second))
            n = jax.nn.relu(hidden + _pair_norm(self.nodes.skip_norm, skip_own, skip_other))
            entered = cpu_matmul.add_bias(edges.project_with(n, entry[0]), entry[1])
            values = _after_first(self.edges, entered).reshape(*own.shape[:2], -1, width)
            return values if then is None else then(values)

        kind, (own, *scene) = type(edges), edges
        return blockwise_map(update, (first_other, skip_other, *scene), (first_own, skip_own, own), real, real.shape[1])


class FactorizedBlock(nnx.Module):
    """Lanes among themselves, lanes to agents, agents among themselves, then the lane pairs."""

    def __init__(
        self,
        lane: tuple[int, int, int],
        agent: tuple[int, int, int],
        edge_width: int,
        *,
        init: ParamInit,
        compute: Compute,
        update_edges: bool = True,
    ):
        """``lane`` and ``agent`` are (width, heads, feed-forward width)."""
        self.lane_lane = GraphAttention(*lane, init=init, edge_width=edge_width, compute=compute)
        self.down = Linear(lane[0], agent[0], init=init, compute=compute)
        self.lane_agent = GraphAttention(*agent, init=init, compute=compute)
        self.agent_agent = GraphAttention(*agent, init=init, compute=compute)
        self.edge_update = EdgeUpdate(agent[0], edge_width, init=init, compute=compute) if update_edges else None

    def __call__(
        self,
        nodes: PerType,
        edges: Edges,
        masks: PairMasks,
        then: Callable[[Array], Any] | None = None,
        trace: Trace = None,
    ) -> tuple[PerType, Any]:
        """New nodes and ``then(new edge values)`` (see ``EdgeUpdate``; None without an edge update)."""
        lanes = self.lane_lane(nodes.lanes, masks.lane_lane, edges=edges)
        real = masks.lane_lane.any(-1)
        down = self.down(lanes)
        after_lanes = self.lane_agent(nodes.agents, masks.agent_lane, sources=down)
        agents = self.agent_agent(after_lanes, masks.agent_agent)
        if trace is not None:
            trace.update(lane=lanes, lane_down=down, agent_after_l2a=after_lanes, agent=agents)
            if self.edge_update is not None:
                trace["edge"] = self.edge_update(down, edges, real)
        updated = None if self.edge_update is None else self.edge_update(down, edges, real, then)
        return PerType(agents=agents, lanes=lanes), updated


def link_head(head: ResidualMLP) -> Callable[[Array], Array]:
    """``head`` on edge values, in the form that is cheap for many rows."""

    def apply(values: Float[Array, "b i j c"]) -> Float[Array, "b i j k"]:
        flat = values.reshape(-1, values.shape[-1])
        out = _after_first(head, _mean_free_product(flat, head.linears[0], head.skip))
        return out.reshape(*values.shape[:-1], -1)

    return apply


# Products with pairs have many rows and 64 columns; there float32 is faster than bfloat16 on CPUs with AMX (measured:
# 0.5 against 1.2 ms for 10,000 x 64 x 64), so they ignore ``compute``.
#
# Linear followed by LN, over many rows: subtracting the mean over the output features from kernel and bias makes the
# product mean-free, and the norm needs one pass less.


def _mean_free_kernels(*linears: Linear) -> tuple[Array, Array]:
    """Kernels and biases of layers that read the same, side by side: one wide product runs faster than narrow ones."""
    biases = [linear.bias for linear in linears if linear.bias is not None]
    assert len(biases) == len(linears)
    kernels = jnp.concatenate([subtract_mean(linear.kernel[...]) for linear in linears], 1)
    return kernels, jnp.concatenate([subtract_mean(bias[...]) for bias in biases])


def _mean_free_product(x: Array, *linears: Linear) -> Array:
    kernel, bias = _mean_free_kernels(*linears)
    return cpu_matmul.linear(x, kernel, bias)


def _norm(norm: LayerNorm, x: Array) -> Array:
    """LN of mean-free rows x [pairs, C]."""
    return cpu_matmul.affine(x, cpu_matmul.rstd(x, EPS), norm.scale[...], norm.bias[...])


def _after_first(mlp: ResidualMLP, entered: Array) -> Array:
    """``ResidualMLP.after_first`` for mean-free products, that of the first layer beside that of the skip."""
    first, skip = jnp.split(entered, 2, -1)
    hidden = _norm(mlp.norms[0], first)
    for linear, norm in zip(list(mlp.linears)[1:], list(mlp.norms)[1:], strict=True):
        hidden = _norm(norm, _mean_free_product(jax.nn.relu(hidden), linear))
    hidden = jax.nn.relu(hidden + _norm(mlp.skip_norm, skip))
    return hidden if mlp.out is None else mlp.out(hidden)


def _pair_products(linear: Linear, e: Float[Array, "b l d"]) -> tuple[Array, Array]:
    """Mean-free shares of destination and source in [e_i; e_j] W + b, [B, L, C] each."""
    kernel, bias = _mean_free_kernels(linear)
    width = e.shape[-1]
    destination = matmul(e, kernel[:width], linear.compute) + bias[None, None]
    return destination, matmul(e, kernel[width:], linear.compute)


def _pair_norm(norm: LayerNorm, destination: Array, source: Array) -> Array:
    """LN of destination_i + source_j, [pairs, C]."""
    rstd = pair_rstd(destination, source).reshape(-1, 1)
    both = (destination[:, :, None] + source[:, None]).reshape(-1, destination.shape[-1])
    return cpu_matmul.affine(both, rstd, norm.scale[...], norm.bias[...])
