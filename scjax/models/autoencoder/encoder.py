"""Scene -> posterior over the latents of its nodes, and over the number of lanes behind x = 0 (official-spec §2.2)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float

from scjax.models.autoencoder.blocks import FactorizedBlock, GraphAttention, Trace, pair_masks
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.edges import DenseEdges, TypedEdges
from scjax.models.autoencoder.outputs import Posterior
from scjax.models.codec import NormalizedScene
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear, ResidualMLP
from scjax.scene.per_type import PerType


class SceneEncoder(nnx.Module):
    """Two factorized blocks over lanes, agents and lane pairs; a query token predicts the number of lanes at x > 0."""

    def __init__(self, config: AutoencoderConfig, *, init: ParamInit):
        c, options = config, {"init": init, "compute": config.compute}
        lane, agent = (c.lane_width, c.lane_heads, c.lane_ff), (c.agent_width, c.agent_heads, c.agent_ff)
        self.lane_in = ResidualMLP(c.lane_inputs, c.lane_width, **options)
        self.agent_in = ResidualMLP(c.agent_inputs, c.agent_width, **options)
        self.link_in = ResidualMLP(c.link_types, c.edge_width, **options)
        # Nothing reads the edges after the last block, so it does not update them.
        self.blocks = nnx.List(
            [
                FactorizedBlock(lane, agent, c.edge_width, update_edges=i + 1 < c.encoder_blocks, **options)
                for i in range(c.encoder_blocks)
            ]
        )
        self.query = nnx.Param(init.xavier((1, c.lane_width)))
        self.query_attention = GraphAttention(*lane, **options)
        self.lane_mean, self.lane_logvar = (Linear(c.lane_width, c.lane_latent, **options) for _ in range(2))
        self.agent_mean, self.agent_logvar = (Linear(c.agent_width, c.agent_latent, **options) for _ in range(2))
        self.lane_count = ResidualMLP(c.lane_width, c.lane_width, features_out=c.max_lanes + 1, **options)
        self.config = config

    def __call__(self, tokens: NormalizedScene, trace: Trace = None) -> Posterior:
        """Posterior of a batch of scenes [B]; rows of padding are zero."""
        check_tokens(tokens, self.config)
        tokens = jax.tree.map(jnp.asarray, tokens)
        mask = PerType(agents=tokens.agent_mask, lanes=tokens.lane_mask)
        behind = PerType(agents=tokens.agent_behind & mask.agents, lanes=tokens.lane_behind & mask.lanes)
        masks = pair_masks(mask, behind)
        agents, lanes = agent_inputs(tokens, self.config), lane_inputs(tokens, self.config)
        nodes = PerType(agents=self.agent_in(agents), lanes=self.lane_in(lanes))
        edges = self._edges(tokens, nodes.lanes.dtype)
        if trace is not None:
            trace.update(embed_lane=nodes.lanes, embed_agent=nodes.agents, embed_edge=edges.dense())

        query = jnp.broadcast_to(self.query[...][None], (nodes.lanes.shape[0], 1, nodes.lanes.shape[2]))
        for i, block in enumerate(self.blocks):
            inner: Trace = None if trace is None else {}
            nodes, values = block(nodes, edges, masks, trace=inner)
            query = self.query_attention(query, behind.lanes[:, None], sources=nodes.lanes)
            if trace is not None and inner is not None:
                trace.update({f"block{i}/{name}": value for name, value in inner.items()})
                trace[f"block{i}/query"] = query[:, 0]
            edges = edges if values is None else DenseEdges(values)

        return Posterior(
            mean=_masked(PerType(agents=self.agent_mean(nodes.agents), lanes=self.lane_mean(nodes.lanes)), mask),
            logvar=_masked(PerType(agents=self.agent_logvar(nodes.agents), lanes=self.lane_logvar(nodes.lanes)), mask),
            lane_count_logits=self.lane_count(query[:, 0]),
        )

    def _edges(self, tokens: NormalizedScene, dtype: jnp.dtype) -> TypedEdges:
        table = self.link_in(jnp.eye(self.config.link_types, dtype=dtype))
        pairs = tokens.lane_mask[:, :, None] & tokens.lane_mask[:, None]
        types = jnp.where(pairs, tokens.links, 0).swapaxes(1, 2)
        return TypedEdges(types, jnp.broadcast_to(table[None], (types.shape[0], *table.shape)))


def agent_inputs(tokens: NormalizedScene, config: AutoencoderConfig) -> Float[Array, "b a i"]:
    """State, one-hot type and known flags; zero at padding."""
    parts = [tokens.agents, jax.nn.one_hot(tokens.agent_types, config.agent_types, dtype=tokens.agents.dtype)]
    parts += [tokens.agent_known[..., [column]].astype(tokens.agents.dtype) for column in config.agent_flags]
    return jnp.where(tokens.agent_mask[..., None], jnp.concatenate(parts, -1), 0.0)


def lane_inputs(tokens: NormalizedScene, config: AutoencoderConfig) -> Float[Array, "b l i"]:
    """Points, one-hot type and known flags; zero at padding."""
    points = tokens.lanes.reshape(*tokens.lanes.shape[:-2], -1)
    parts = [points]
    if config.lane_types:
        parts += [jax.nn.one_hot(tokens.lane_types, config.lane_types, dtype=points.dtype)]
    parts += [tokens.lane_known[..., [dim]].astype(points.dtype) for dim in config.lane_flags]
    return jnp.where(tokens.lane_mask[..., None], jnp.concatenate(parts, -1), 0.0)


def check_tokens(tokens: NormalizedScene, config: AutoencoderConfig) -> None:
    """Raises ValueError where the arrays do not fit the network."""
    if tokens.agent_mask.ndim != 2:
        raise ValueError(
            f"agent_mask has shape {tokens.agent_mask.shape}, but the autoencoder needs one batch axis [B, A]"
        )
    expected = {
        "agents": (*tokens.agent_mask.shape, config.columns),
        "lanes": (*tokens.lane_mask.shape, config.points, config.point_dims),
        "links": (*tokens.lane_mask.shape, tokens.lane_mask.shape[1]),
    }
    for name, shape in expected.items():
        if getattr(tokens, name).shape != shape:
            raise ValueError(
                f"tokens.{name} has shape {getattr(tokens, name).shape}, but the masks and the configuration need "
                f"{shape}: normalize the scene with the codec of this model"
            )


def _masked(values: PerType, mask: PerType) -> PerType:
    return jax.tree.map(lambda x, m: jnp.where(m[..., None], x, 0.0), values, mask)
