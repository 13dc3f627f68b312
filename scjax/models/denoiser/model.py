"""The denoiser: noisy latents of agents and lanes, time, label -> estimate of noise or velocity (official-spec §4).

A factorized block has four stages, in this order: agents to lanes, lanes to lanes, lanes to agents, agents to agents.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float, Int, Real

from scjax.models.denoiser.attribute_embedding import AttributeEmbedding
from scjax.models.denoiser.config import DenoiserConfig, ImageCondition, TextCondition
from scjax.models.denoiser.context import ConditionFeatures, ImageContext, ImageFeatures, TextContext, TextFeatures
from scjax.models.denoiser.embed import TIME_CODE, position_table, time_code
from scjax.models.denoiser.fourier_features import FourierFeatures
from scjax.models.denoiser.kind_embedding import KindEmbedding
from scjax.models.denoiser.position_head import PositionHeads
from scjax.models.denoiser.relative_geometry import RelativeGeometry
from scjax.models.denoiser.stage import AttentionStage, Head
from scjax.nn.cross_attention import AuxOutputs, NoOptions
from scjax.nn.functional import Functional, functional
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear, ResidualMLP
from scjax.scene.per_type import PerType

_STD = 0.02  # of tables and of the time and text MLPs


@functools.lru_cache(maxsize=16)
def denoiser(config: DenoiserConfig) -> Functional:
    """The network as pure functions ``init(key)`` and ``apply(params, z, t, label, masks, ...)``; see ``Denoiser``.

    ``apply(..., method=...)`` runs "encode_condition" or "modulation".
    """
    return functional(lambda init: Denoiser(config, init=init))


class Block(nnx.Module):
    """The four stages, with projections between the two widths."""

    def __init__(self, config: DenoiserConfig, *, init: ParamInit):
        def stage(width, heads):
            return AttentionStage(
                width,
                heads,
                init=init,
                mlp_ratio=config.mlp_ratio,
                compute=config.compute,
                cross_adaln_init=config.cross_adaln_init,
                spec=config.context_spec,
                cross_attention=None if config.condition is None else config.cross_attention,
            )

        lane, agent = (config.lane_width, config.lane_heads), (config.agent_width, config.agent_heads)
        self.agents_up = Linear(agent[0], lane[0], init=init, compute=config.compute)
        self.lanes_down = Linear(lane[0], agent[0], init=init, compute=config.compute)
        self.a2l = stage(*lane)
        self.l2l = nnx.List([stage(*lane) for _ in range(config.l2l_stages)])
        self.l2a = stage(*agent)
        self.a2a = stage(*agent)

    def stages(self) -> dict[str, tuple[str, AttentionStage]]:
        """Name -> (type that the stage updates, stage), in the order of evaluation."""
        lane_stages = {name: ("lanes", stage) for name, stage in zip(_l2l_names(len(self.l2l)), self.l2l, strict=True)}
        return {"a2l": ("lanes", self.a2l), **lane_stages, "l2a": ("agents", self.l2a), "a2a": ("agents", self.a2a)}

    def modulation(self, wide: PerType, narrow: PerType) -> dict:
        """AdaLN chunks of every stage from the conditioning vectors at both widths (after SiLU)."""
        chunks = {}
        for name, (kind, stage) in self.stages().items():
            if name == "a2l":
                chunks[name] = stage.modulation(wide.lanes, wide.agents)
            elif name == "l2a":
                chunks[name] = stage.modulation(narrow.agents, narrow.lanes)
            else:
                chunks[name] = stage.modulation(wide.lanes if kind == "lanes" else narrow.agents)
        return chunks

    def encode(self, context: PerType, mask: Bool[Array, "b m"]) -> dict:
        """Cross-attention cache of every stage."""
        caches = {}
        for name, (kind, stage) in self.stages().items():
            assert stage.cross is not None
            caches[name] = stage.cross.encode(getattr(context, kind), mask)
        return caches

    def __call__(
        self, x: PerType, modulation: dict, masks: PerType, cache: dict | None, trace: dict | None
    ) -> tuple[PerType, dict[str, AuxOutputs]]:
        """The updated tokens, and the losses and metrics of the conditioning, by stage."""
        sources = {"a2l": ("agents", self.agents_up), "l2a": ("lanes", self.lanes_down)}
        aux = {}
        for name, (kind, stage) in self.stages().items():
            stage_trace = None if trace is None else {}
            other, project = sources.get(name, (kind, None))
            updated, aux_outputs = stage(
                getattr(x, kind),
                getattr(masks, kind),
                modulation[name],
                getattr(masks, other),
                None if project is None else project(getattr(x, other)),
                cache[name] if cache else None,
                stage_trace,
            )
            x = x.replace(**{kind: updated})
            if aux_outputs is not None:
                aux[name] = aux_outputs
            if trace is not None and stage_trace is not None:
                stage_trace["out"] = updated
                trace |= {f"{name}/{key}": value for key, value in stage_trace.items()}
        return x, aux


class Denoiser(nnx.Module):
    """Noisy latents -> estimate of the noise or a velocity; see ``__call__``."""

    def __init__(self, config: DenoiserConfig, *, init: ParamInit):
        def table(rows, width):
            return nnx.Param(init.normal((rows, width), _STD))

        lane, agent, compute = config.lane_width, config.agent_width, config.compute
        # Full precision: at low noise levels the little noise must be separated from latents that are mostly signal.
        self.lane_embedder = ResidualMLP(config.lane_latent, lane, init=init)
        self.agent_embedder = ResidualMLP(config.agent_latent, agent, init=init)
        self.lane_fourier = _fourier_features(config, config.lane_latent, lane, init)
        self.agent_fourier = _fourier_features(config, config.agent_latent, agent, init)
        self.position_heads = (
            PositionHeads(config.agent_latent, config.lane_latent, init=init) if config.relative_geometry else None
        )
        self.relative_geometry = (
            RelativeGeometry(PerType(agents=agent, lanes=lane), init=init, compute=compute)
            if config.relative_geometry
            else None
        )
        self.time_in = Linear(TIME_CODE, lane, init=init, compute=compute, std=_STD)
        self.time_out = Linear(lane, lane, init=init, compute=compute, std=_STD)
        self.labels = table(config.null_label + 1, lane)
        self.attributes = AttributeEmbedding(len(config.attributes), lane, init=init) if config.attributes else None
        self.agent_kinds = KindEmbedding(config.agent_kinds, agent) if config.agent_kinds else None
        self.lane_kinds = KindEmbedding(config.lane_kinds, lane) if config.lane_kinds else None
        self.lane_counts = table(config.max_lanes + 1, lane)
        self.agent_counts = table(config.max_agents + 1, lane)
        self.narrow = Linear(lane, agent, init=init, compute=compute)
        self.blocks = nnx.List([Block(config, init=init) for _ in range(config.blocks)])
        self.lane_head = Head(lane, config.lane_latent, init=init, compute=compute)
        self.agent_head = Head(agent, config.agent_latent, init=init, compute=compute)
        self.lane_known = nnx.Param(jnp.zeros(lane)) if config.known_embedding else None
        self.agent_known = nnx.Param(jnp.zeros(agent)) if config.known_embedding else None
        context = None
        if isinstance(config.cross_attention, NoOptions):
            pass  # no stage would read it
        elif isinstance(config.condition, TextCondition):
            context = TextContext(config, config.condition, init=init)
        elif isinstance(config.condition, ImageCondition):
            context = ImageContext(config, config.condition, init=init)
        self.context = context
        self.config = config

    def encode_condition(
        self, features: ConditionFeatures, dropped: Bool[Array, " b"], trace: dict | None = None
    ) -> list:
        """Features -> cross-attention caches (one dict per block), reusable in every denoising step.

        ``dropped`` scenes get the null condition, the same in training and in the unconditional branch of the sampler.
        Their features are ignored, NaN included.

        Raises:
          ValueError: the network has no condition, or the features are of another kind.
        """
        if self.config.condition is None:
            raise ValueError("this denoiser is unconditional (config.condition is None): it has no condition to encode")
        if self.context is None:
            return [{} for _ in self.blocks]
        if isinstance(features, ImageFeatures) and features.present is not None:
            dropped = dropped | ~jnp.asarray(features.present)
        if isinstance(self.context, TextContext) and isinstance(features, TextFeatures):
            context, mask = self.context(features, dropped, trace)
        elif isinstance(self.context, ImageContext) and isinstance(features, ImageFeatures):
            context, mask = self.context(features, dropped, trace)
        else:
            raise ValueError(
                f"this denoiser was built with {type(self.config.condition).__name__}, got {type(features).__name__}"
            )
        if self.config.attend_padding:
            context = jax.tree.map(lambda tokens: jnp.where(dropped[:, None, None], 0, tokens), context)
            mask = jnp.ones_like(mask)
        if trace is not None:
            trace |= {"ctx_lane": context.lanes, "ctx_agent": context.agents, "ctx_mask": mask}
        return [block.encode(context, mask) for block in self.blocks]

    def modulation(
        self,
        t: Real[Array, " b"],
        label: Int[Array, " b"],
        counts: PerType,
        attributes: Float[Array, "b a"] | None = None,
        trace: dict | None = None,
    ) -> dict:
        """All AdaLN chunks, one row per scene and type.

        ``counts`` are the numbers of valid tokens [B] per type, ``attributes`` the features of requests. The chunks do
        not depend on the latents: a sampler of few scenes can precompute them for all steps at once.
        """
        time = self.time_out(jax.nn.silu(self.time_in(time_code(t, self.labels.dtype))))
        kind = self.labels[...][label]
        if self.attributes is not None and attributes is not None:
            kind = kind + self.attributes(attributes)
        number = PerType(agents=self.agent_counts[...][counts.agents], lanes=self.lane_counts[...][counts.lanes])
        wide = jax.tree.map(lambda n: time + kind + n, number)
        narrow = jax.tree.map(self.narrow, wide)
        if trace is not None:
            trace |= {"t_emb": time, "y": kind, "n_lane": number.lanes, "n_agent": number.agents}
            trace |= {"c_lane": wide.lanes, "c_agent": wide.agents}
            trace |= {"c_small_lane": narrow.lanes, "c_small_agent": narrow.agents}
        wide, narrow = jax.tree.map(jax.nn.silu, (wide, narrow))
        heads = PerType(agents=self.agent_head.modulation(narrow.agents), lanes=self.lane_head.modulation(wide.lanes))
        return {"blocks": [block.modulation(wide, narrow) for block in self.blocks], "heads": heads}

    def __call__(
        self,
        z: PerType,
        t: Real[Array, " b"],
        label: Int[Array, " b"],
        masks: PerType,
        known: PerType | None = None,
        cache: list | None = None,
        modulation: dict | None = None,
        attributes: Float[Array, "b a"] | None = None,
        kinds: PerType | None = None,
        trace: dict | None = None,
        aux: dict[str, AuxOutputs] | None = None,
    ) -> PerType:
        """Estimate of the noise or a velocity (``config.prediction``), shaped as ``z``; zero at padding.

        Args:
          z: noisy latents [B, tokens, latent] per type, in token order (scjax.data.token_order); padding may hold
            anything.
          t: timesteps 0..99; for a rectified flow also fractions (``diffusion.flow``).
          label: ``config.domains * crop + domain``, or ``config.null_label``.
          masks: True at valid tokens [B, tokens].
          known: True at known (clean) tokens; used by ``known_embedding`` only.
          cache: from ``encode_condition``; None leaves the condition out. A cache of fewer scenes than the batch
            belongs to the first scenes; the others count as dropped. (So the null branch of guidance needs no cache,
            unless ``attend_padding``.)
          modulation: precomputed by ``modulation``; then ``t``, ``label`` and ``attributes`` are ignored.
          attributes: features of requests, by the names of ``config.attributes``; None, as zeros, asks nothing.
          kinds: kind of each token [B, tokens] per type (``denoiser.kinds``), -1 where the network decides; None: it
            decides on all.
          trace: receives intermediate arrays, named as in the golden vectors, if it is a dict.
          aux: receives losses and metrics of the conditioning, by block and stage, if it is a dict.
        """
        z = jax.tree.map(lambda latents, mask: jnp.where(mask[..., None], latents, 0), z, masks)
        tokens = PerType(agents=self.agent_embedder(z.agents), lanes=self.lane_embedder(z.lanes))
        if self.lane_fourier is not None and self.agent_fourier is not None:
            fourier_features = PerType(agents=self.agent_fourier(z.agents), lanes=self.lane_fourier(z.lanes))
            tokens = jax.tree.map(jnp.add, tokens, fourier_features)
        if self.relative_geometry is not None and self.position_heads is not None:
            tokens = jax.tree.map(jnp.add, tokens, self.relative_geometry(self.position_heads(z), masks))
        if trace is not None:
            trace |= {"embed_lane": tokens.lanes, "embed_agent": tokens.agents}
        config = self.config
        tables = PerType(
            agents=position_table(config.max_lanes, config.max_agents, config.agent_width),
            lanes=position_table(0, config.max_lanes, config.lane_width),
        )
        tokens = jax.tree.map(_add_positions, tokens, masks, tables)
        if self.lane_known is not None and self.agent_known is not None and known is not None:
            vectors = PerType(agents=self.agent_known[...], lanes=self.lane_known[...])
            tokens = jax.tree.map(
                lambda x, flag, vector: x + jnp.where(flag[..., None], vector[None, None], 0), tokens, known, vectors
            )
        if self.agent_kinds is not None and self.lane_kinds is not None and kinds is not None:
            vectors = PerType(agents=self.agent_kinds(kinds.agents), lanes=self.lane_kinds(kinds.lanes))
            tokens = jax.tree.map(jnp.add, tokens, vectors)
        if modulation is None:
            counts = jax.tree.map(lambda mask: mask.sum(-1, dtype=jnp.int32), masks)
            modulation = self.modulation(t, label, counts, attributes, trace)
        if trace is not None:
            trace |= {"tok_lane": tokens.lanes, "tok_agent": tokens.agents}
            for i, chunks in enumerate(modulation["blocks"]):
                for name, stage in chunks.items():
                    parts = {"adaln": stage.to, "adaln_src": stage.source, "adaln_cross": stage.cross}
                    trace |= {f"b{i}/{name}/{part}": x for part, x in parts.items() if x is not None}
        for i, block in enumerate(self.blocks):
            stage_trace = None if trace is None else {}
            tokens, aux_outputs = block(
                tokens, modulation["blocks"][i], masks, None if cache is None else cache[i], stage_trace
            )
            if aux is not None:
                aux |= {f"b{i}/{name}": value for name, value in aux_outputs.items()}
            if trace is not None and stage_trace is not None:
                trace |= {f"b{i}/{name}": value for name, value in stage_trace.items()}
        heads = modulation["heads"]
        eps = PerType(
            agents=self.agent_head(tokens.agents, heads.agents), lanes=self.lane_head(tokens.lanes, heads.lanes)
        )
        return jax.tree.map(lambda noise, mask: jnp.where(mask[..., None], noise, 0), eps, masks)


def _fourier_features(config: DenoiserConfig, latent: int, width: int, init: ParamInit) -> FourierFeatures | None:
    if not config.fourier_features:
        return None
    octaves, compute = config.fourier_octaves, config.compute
    return FourierFeatures(latent, width, config.fourier_features, init=init, octaves=octaves, compute=compute)


def _add_positions(
    x: Float[Array, "b n d"], mask: Bool[Array, "b n"], table: Float[np.ndarray, "rows d"]
) -> Float[Array, "b n d"]:
    rank = jnp.clip(jnp.cumsum(mask, -1, dtype=jnp.int32) - 1, 0, len(table) - 1)
    return x + jnp.asarray(table, x.dtype)[rank]


def _l2l_names(count: int) -> list[str]:
    return ["l2l"] if count == 1 else [f"l2l{i}" for i in range(count)]
