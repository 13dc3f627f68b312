"""Closed-form multiply-adds of the conditioning mechanisms (attention-variants §4), as ``flops`` counts them.

What a sparse mechanism saves is counted as saved, whichever form computes it.
"""

from __future__ import annotations

from typing import NamedTuple

from scjax.nn.cross_attention import ContextSpec, CrossAttentionOptions
from scjax.nn.cross_attention.agent import AgentOptions
from scjax.nn.cross_attention.concat import ConcatOptions
from scjax.nn.cross_attention.cross_global import CrossGlobalOptions
from scjax.nn.cross_attention.deformable import DeformableOptions
from scjax.nn.cross_attention.full import FullOptions
from scjax.nn.cross_attention.gated import GatedOptions
from scjax.nn.cross_attention.linear import LinearOptions
from scjax.nn.cross_attention.saap import SaapOptions
from scjax.nn.cross_attention.squeezed import SqueezedOptions
from scjax.nn.cross_attention.windowed import WindowedOptions


class Work(NamedTuple):
    """Multiply-adds of one module and scene: what depends on the context alone, and what every step repeats."""

    encode: float
    attend: float


def control_work(
    options: CrossAttentionOptions, width: int, heads: int, spec: ContextSpec, queries: int, context: int
) -> Work:  # fmt: skip
    """Of ``queries`` scene tokens and ``context`` condition tokens."""
    n, m, d, size = queries, context, width, width // heads
    project, square = 2 * m * d * d, n * d * d
    match options:
        case ConcatOptions():
            return Work(project, 4 * square + 2 * n * (n + m) * d)
        case FullOptions(memory_tokens=memory, inner_ratio=ratio):
            return Work(ratio * 2 * (m + memory) * d * d, ratio * (2 * square + 2 * n * (m + memory) * d))
        case GatedOptions(feed_forward=feed_forward):
            return Work(project, (10 if feed_forward else 2) * square + 2 * n * m * d)
        case LinearOptions():
            return Work(project + m * d * size, 2 * square + n * d * size)
        case AgentOptions(tokens=tokens, pooling=pooling):
            tokens = tokens or (32 if d <= 256 else 49)
            gather, pool = 2 * tokens * m * d, {"segment": 1, "set": 2, "learned": 0}[pooling] * tokens * n * d
            read = 2 * square + pool + 2 * n * tokens * d
            return Work(project + gather, read) if pooling == "learned" else Work(project, gather + read)
        case SaapOptions(buckets=buckets, probes=probes, router_width=hidden):
            hidden = hidden or max(64, size)
            route = n * heads * hidden * (size + buckets)
            return Work(project + m * buckets * d, 2 * square + route + 2 * n * probes * m / buckets * d)
        case WindowedOptions(window=window, per_modality=per_modality):
            parts = spec.modalities if per_modality else 1
            window = window or (32 if spec.kind == "image" and per_modality else 64)
            return Work(project, 2 * square + 2 * n * parts * min(2 * window + 1, m // parts) * d)
        case DeformableOptions(points=points):
            axes, samples = (1 if spec.grid is None else 2), heads * spec.modalities * points
            predict = n * d * (axes + (axes + 1) * samples)
            return Work(m * d * d, square + predict + n * 2**axes * spec.modalities * points * d)
        case SqueezedOptions(clusters=clusters, keep=keep, iterations=iterations):
            return Work(project + iterations * m * clusters * d, 2 * square + n * clusters * d + 2 * n * keep * m * d)
        case CrossGlobalOptions(latent_tokens=latents):
            encode = project + 3 * latents * d * d + 2 * latents * m * d
            return Work(encode, 3 * square + 2 * n * (m + latents) * d)
        case _:
            return Work(0, 0)
