"""The attention stage of a factorized block, and the heads, both modulated by AdaLN (official-spec §4.2-4.4).

Modulation is one row per scene and type, broadcast over tokens. A bipartite stage computes only the rows it updates.
"""

from __future__ import annotations

from typing import Any, Literal

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from scjax.nn.attention import attend
from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention import AuxOutputs, ContextSpec, CrossAttentionOptions, NoOptions, build_cross_attention
from scjax.nn.init import ParamInit
from scjax.nn.layers import Linear, standardize
from scjax.scene.pytree import pytree

_ZERO = 0.0  # standard deviation of parameters that start at zero (adaLN-Zero)


@pytree
class StageModulation:
    """AdaLN chunks of a stage.

    Attributes:
      to: shift, scale, gate of the attention, then of the MLP, for the tokens that the stage updates.
      source: the same for the other type, in a bipartite stage (only the first shift and scale are used).
      cross: shift, scale, gate of the cross-attention, in a conditioned stage.
    """

    to: Float[Array, "b 6 d"]
    source: Float[Array, "b 6 d"] | None
    cross: Float[Array, "b 3 d"] | None


class AttentionStage(nnx.Module):
    """Attention to the sources, cross-attention to the condition (if any), MLP; each modulated and gated."""

    def __init__(
        self,
        width: int,
        heads: int,
        *,
        init: ParamInit,
        mlp_ratio: int = 4,
        cross_attention: CrossAttentionOptions | None = None,
        spec: ContextSpec | None = None,
        cross_adaln_init: Literal["zero", "xavier"] = "zero",
        compute: Compute = "float32",
    ):
        def linear(features_in, features_out, std=None):
            return Linear(features_in, features_out, init=init, compute=compute, std=std)

        self.adaln = linear(width, 6 * width, _ZERO)
        self.q, self.k, self.v, self.out = (linear(width, width) for _ in range(4))
        self.up, self.down = linear(width, mlp_ratio * width), linear(mlp_ratio * width, width)
        cross_adaln = cross = None
        if cross_attention is not None and not isinstance(cross_attention, NoOptions):
            cross_adaln = linear(width, 3 * width, _ZERO if cross_adaln_init == "zero" else None)
            cross = build_cross_attention(
                cross_attention, width, heads, spec or ContextSpec(), init=init, compute=compute
            )
        self.cross_adaln, self.cross = cross_adaln, cross
        self.heads, self.cross_attention = heads, cross_attention

    def modulation(self, to: Float[Array, "b d"], source: Float[Array, "b d"] | None = None) -> StageModulation:
        """AdaLN chunks from the conditioning vectors (after SiLU) of the updated type and, in a bipartite stage, the
        sources."""
        rows = [to] if source is None else [to, source]
        chunks = _chunks(self.adaln(jnp.concatenate(rows)), 6)
        return StageModulation(
            to=chunks[: len(to)],
            source=None if source is None else chunks[len(to) :],
            cross=None if self.cross_adaln is None else _chunks(self.cross_adaln(to), 3),
        )

    def __call__(
        self,
        x: Float[Array, "b n d"],
        mask: Bool[Array, "b n"],
        modulation: StageModulation,
        source_mask: Bool[Array, "b m"],
        source: Float[Array, "b m d"] | None = None,
        cache: Any = None,
        trace: dict | None = None,
    ) -> tuple[Float[Array, "b n d"], AuxOutputs | None]:
        """Updates the tokens x from ``source`` (None: x itself) and the condition.

        Args:
          mask, source_mask: True at real tokens of x and of the sources.
          cache: of the condition. A cache of fewer scenes than the batch belongs to the first scenes; the others have
            no condition.
          trace: receives intermediate arrays if it is a dict.
        """
        shift, scale, gate, mlp_shift, mlp_scale, mlp_gate = _split_chunks(modulation.to)
        hidden = modulate(x, shift, scale)
        read = hidden
        if source is not None:
            assert modulation.source is not None
            read = modulate(source, *_split_chunks(modulation.source)[:2])
        mixed = self.out(attend(self.q(hidden), self.k(read), self.v(read), source_mask[:, None], self.heads))
        x = x + gate * mixed
        if trace is not None:
            trace["attn"] = mixed
        aux, cache = None, self._complete(cache, x)
        if cache is not None:
            assert self.cross is not None and modulation.cross is not None
            num_conditioned = _scenes(cache)  # the scenes that have a condition come first
            shift, scale, gate = _split_chunks(modulation.cross[:num_conditioned])
            hidden = modulate(x[:num_conditioned], shift, scale)
            crossed, aux = self.cross.attend(hidden, mask[:num_conditioned], cache)
            x = jnp.concatenate([x[:num_conditioned] + gate * crossed, x[num_conditioned:]])
            if trace is not None:
                trace |= {"cross_in": hidden, "cross": crossed}
        update = self.down(jax.nn.gelu(self.up(modulate(x, mlp_shift, mlp_scale)), approximate=True))
        if trace is not None:
            trace["mlp"] = update
        return x + mlp_gate * update, aux

    def _complete(self, cache: Any, x: Float[Array, "b n d"]) -> Any:
        """The cache of all scenes, if scenes without condition do not get zero (``empty_is_zero`` is False)."""
        if self.cross is None or self.cross_attention is None or self.cross_attention.empty_is_zero:
            return cache
        if cache is None:
            nothing = jnp.zeros((len(x), 1, x.shape[2]), x.dtype)
            return self.cross.encode(nothing, jnp.zeros(nothing.shape[:2], bool))
        # Zeros read as "no readable key".
        missing = len(x) - _scenes(cache)
        return jax.tree.map(lambda leaf: jnp.pad(leaf, [(0, missing), *[(0, 0)] * (leaf.ndim - 1)]), cache)


class Head(nnx.Module):
    """Modulated layer norm without parameters and a linear map to the estimate; zero at first."""

    def __init__(self, width: int, features_out: int, *, init: ParamInit, compute: Compute = "float32"):
        self.adaln = Linear(width, 2 * width, init=init, compute=compute, std=_ZERO)
        self.linear = Linear(width, features_out, init=init, compute=compute, std=_ZERO)

    def modulation(self, to: Float[Array, "b d"]) -> Float[Array, "b 2 d"]:
        """Shift and scale from the conditioning vector (after SiLU)."""
        return _chunks(self.adaln(to), 2)

    def __call__(self, x: Float[Array, "b n d"], modulation: Float[Array, "b 2 d"]) -> Float[Array, "b n o"]:
        return self.linear(modulate(x, *_split_chunks(modulation)))


def modulate(
    x: Float[Array, "b n d"], shift: Float[Array, "b 1 d"], scale: Float[Array, "b 1 d"]
) -> Float[Array, "b n d"]:
    """Layer norm without parameters (eps 1e-6), then x (1 + scale) + shift."""
    return standardize(x, 1e-6) * (1 + scale) + shift


def _scenes(cache: Any) -> int:
    return len(jax.tree.leaves(cache)[0])


def _chunks(x: Float[Array, "b cd"], count: int) -> Float[Array, "b c d"]:
    return x.reshape(len(x), count, -1)


def _split_chunks(chunks: Float[Array, "b c d"]) -> list[Float[Array, "b 1 d"]]:
    return [chunks[:, i : i + 1] for i in range(chunks.shape[1])]
