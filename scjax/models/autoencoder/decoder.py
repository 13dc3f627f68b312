"""Latents -> scene (official-spec §2.3)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array

from scjax.models.autoencoder.blocks import FactorizedBlock, Trace, link_head, pair_masks
from scjax.models.autoencoder.config import AutoencoderConfig
from scjax.models.autoencoder.edges import DenseEdges, PairEdges
from scjax.models.autoencoder.outputs import Decoded
from scjax.nn.cpu.precision import matmul
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear, ResidualMLP
from scjax.scene.per_type import PerType


class SceneDecoder(nnx.Module):
    """Two factorized blocks over all pairs of the scene, then one head per quantity."""

    def __init__(self, config: AutoencoderConfig, *, init: ParamInit):
        c, options = config, {"init": init, "compute": config.compute}
        lane, agent = (c.lane_width, c.lane_heads, c.lane_ff), (c.agent_width, c.agent_heads, c.agent_ff)
        self.lane_in = Linear(c.lane_latent, c.lane_width, **options)
        self.agent_in = Linear(c.agent_latent, c.agent_width, **options)
        self.pair_down = Linear(c.lane_width, c.edge_width, **options)
        self.pair_in = Linear(2 * c.edge_width, c.edge_width, **options)
        self.blocks = nnx.List([FactorizedBlock(lane, agent, c.edge_width, **options) for _ in range(c.decoder_blocks)])
        points = c.points * c.point_dims
        self.agent_states = ResidualMLP(c.agent_width, c.agent_width, depth=3, features_out=c.columns, **options)
        self.agent_types = ResidualMLP(c.agent_width, c.agent_width, features_out=c.agent_types, **options)
        self.lane_points = ResidualMLP(c.lane_width, c.lane_width, depth=3, features_out=points, **options)
        self.lane_types = (
            ResidualMLP(c.lane_width, c.lane_width, features_out=c.lane_types, **options) if c.lane_types else None
        )
        self.links = ResidualMLP(c.edge_width, c.edge_width, features_out=c.link_types, **options)
        self.config = config

    def __call__(self, latents: PerType, mask: PerType, trace: Trace = None) -> Decoded:
        """Decodes latents [B, A, agent_latent], [B, L, lane_latent]; ``mask`` [B, A], [B, L] is True at real nodes."""
        c = self.config
        for name, width in (("agents", c.agent_latent), ("lanes", c.lane_latent)):
            shape, expected = getattr(latents, name).shape, (*getattr(mask, name).shape, width)
            if shape != expected or len(expected) != 3:
                raise ValueError(
                    f"latents.{name} has shape {shape}, but its mask and the configuration need {expected}"
                )
        latents, mask = jax.tree.map(jnp.asarray, (latents, mask))
        masks = pair_masks(mask)
        nodes = PerType(
            agents=self.agent_in(_where(mask.agents, latents.agents)),
            lanes=self.lane_in(_where(mask.lanes, latents.lanes)),
        )
        edges = self._edges(nodes.lanes)
        if trace is not None:
            trace.update(embed_lane=nodes.lanes, embed_agent=nodes.agents, embed_edge=edges.dense())

        links = link_head(self.links)
        for i, block in enumerate(self.blocks):
            inner: Trace = None if trace is None else {}
            last = i + 1 == len(self.blocks)
            nodes, values = block(nodes, edges, masks, then=links if last else None, trace=inner)
            edges = DenseEdges(values)
            if trace is not None and inner is not None:
                trace.update({f"block{i}/{name}": value for name, value in inner.items()})
        link_logits = edges.dense()

        points = self.lane_points(nodes.lanes)
        points = points.reshape(*points.shape[:-1], c.points, c.point_dims)
        none = jnp.zeros((*mask.lanes.shape, 0), points.dtype)
        return Decoded(
            agents=_where(mask.agents, self.agent_states(nodes.agents)),
            agent_type_logits=_where(mask.agents, self.agent_types(nodes.agents)),
            lanes=_where(mask.lanes, points),
            lane_type_logits=none if self.lane_types is None else _where(mask.lanes, self.lane_types(nodes.lanes)),
            link_logits=_where(masks.lane_lane, link_logits).swapaxes(1, 2),
        )

    def _edges(self, lanes: Array) -> PairEdges:
        """c_ij = [p_j; p_i] W + b of destination i, source j: here the source comes first."""
        p, kernel, width = self.pair_down(lanes), self.pair_in.kernel[...], self.config.edge_width
        assert self.pair_in.bias is not None
        source = matmul(p, kernel[:width], self.config.compute)
        destination = matmul(p, kernel[width:], self.config.compute) + self.pair_in.bias[...][None, None]
        return PairEdges(destination, source)


def _where(mask: Array, values: Array) -> Array:
    return jnp.where(mask.reshape(*mask.shape, *(1,) * (values.ndim - mask.ndim)), values, 0.0)
