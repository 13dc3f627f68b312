"""Sliding-window attention: each query reads the keys around one position of the context (attention-variants §4.7).

FlashAttention-2 (Dao 2023, arXiv:2307.08691) aligns query and key positions at their last tokens. In cross-attention a
window that slides along the whole context suits better; both alignments are here. Positions are ranks among valid
tokens, and the rule is one inequality of integers, so padding and rounding never move a window.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, Literal

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import (
    AuxOutputs,
    ContextSpec,
    CrossAttentionOptions,
    Work,
    active_rows,
    at_least,
    mask_rows,
    mean_over,
    one_of,
)
from scjax.nn.cross_attention.gathered import attend_gathered, first_of
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit


@dataclasses.dataclass(frozen=True)
class WindowedOptions(CrossAttentionOptions):
    """Options of ``Windowed``.

    Attributes:
      window: keys on each side of the center; 0 chooses 64, or 32 per modality.
      alignment: center of the window of query i of n among m keys: "diagonal" (i + 1/2) m / n - 1/2; "diagonal_rev"
        the same from the other end; "fa2" i + m - n (queries and keys end together; a window may hold no key).
      per_modality: whether every grid of an image has its own window, around the same cell.
      form: "mask" computes all scores and masks them; "gather" computes only those in the window, which is faster
        from some 1,000 keys on (benchmarks/README.md).
    """

    name: ClassVar[str] = "windowed"

    window: int = 0
    alignment: Literal["diagonal", "diagonal_rev", "fa2"] = "diagonal"
    per_modality: bool = True
    form: Literal["mask", "gather"] = "mask"

    def __post_init__(self):
        at_least(self, window=0)
        one_of(self, alignment=("diagonal", "diagonal_rev", "fa2"), form=("mask", "gather"))

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> Windowed:
        """The module of this mechanism."""
        return Windowed(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        parts = spec.modalities if self.per_modality else 1
        window = self.window or (32 if spec.kind == "image" and self.per_modality else 64)
        read = 2 * queries * parts * min(2 * window + 1, context // parts) * width
        return Work(2 * context * width**2, 2 * queries * width**2 + read)


class Windowed(Projections):
    """y = W_o Attn(Q, K, V) where |rank of the key - center of the query| <= window; 0 for empty windows."""

    def __init__(
        self,
        options: WindowedOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        super().__init__(width, heads, init=init, compute=compute)
        self.parts = spec.modalities if options.per_modality else 1
        self.window = options.window or (32 if spec.kind == "image" and options.per_modality else 64)
        self.options = options

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Keys:
        """Keys and values."""
        if mask.shape[1] % self.parts:
            raise ValueError(f"a context of {self.parts} modalities can't have {mask.shape[1]} tokens")
        return self.project(context, mask)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Keys
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read from their windows."""
        query = self.query(x, x_mask)
        masks = cache.mask.reshape(len(x), self.parts, -1)  # [b parts cells]
        if self.options.form == "mask":
            rank = jnp.cumsum(masks, -1)[:, None] - 1  # [b 1 parts cells]
            inside = masks[:, None] & self._inside(x_mask, masks, rank)
            admitted = inside.reshape(*x_mask.shape, -1)
            attended = self.read(query, cache, admitted)
        else:
            index, admitted = self._window(x_mask, masks)
            shape = (*index.shape[:1], self.heads, *index.shape[1:])
            index, mask = (jnp.broadcast_to(a[:, None], shape) for a in (index, admitted))
            attended = self.offset(attend_gathered(self.scaled_query(query), cache.key, cache.value, index, mask))
        rows = active_rows(x_mask, cache.mask)
        share = admitted.sum(-1) / jnp.maximum(cache.mask.sum(-1, keepdims=True), 1)
        return mask_rows(rows & admitted.any(-1), self.out(attended)), AuxOutputs(
            metrics={"selected": mean_over(rows, share)}
        )

    def _inside(
        self, x_mask: Bool[Array, "b n"], masks: Bool[Array, "b parts cells"], rank: Int[Array, "b n_or_1 parts w"]
    ) -> Bool[Array, "b n parts w"]:
        """Whether keys of these ranks are in the window: |2 n rank - 2 n center| <= 2 n window."""
        center, count = self._center(x_mask, masks)
        return jnp.abs(2 * count * rank - center) <= 2 * count * self.window

    def _center(self, x_mask: Bool[Array, "b n"], masks: Bool[Array, "b parts cells"]) -> tuple[Array, Array]:
        """2 n times the center [b n parts 1] of each window, and n (at least 1) [b 1 1 1]."""
        rank = (jnp.cumsum(x_mask, -1) - 1)[:, :, None, None]
        count = jnp.maximum(x_mask.sum(-1), 1)[:, None, None, None]
        keys = masks.sum(-1)[:, None, :, None]
        if self.options.alignment == "fa2":
            return 2 * count * (rank + keys - count), count
        center = (2 * rank + 1) * keys - count
        return center if self.options.alignment == "diagonal" else 2 * count * (keys - 1) - center, count

    def _window(self, x_mask: Bool[Array, "b n"], masks: Bool[Array, "b parts cells"]) -> tuple[Array, Array]:
        """Indices [b n w] of the keys around each center, and which of them are in the window."""
        cells = masks.shape[-1]
        width = min(2 * self.window + 1, cells)
        center, count = self._center(x_mask, masks)
        first = -((2 * count * self.window - center) // (2 * count))  # the least rank in the window
        rank = jnp.clip(first, 0, cells - width) + jnp.arange(width)[None, None, None]
        position, _ = first_of(masks, cells)  # rank -> cell
        position = position + cells * jnp.arange(self.parts)[None, :, None]
        index = jnp.take_along_axis(position[:, None], rank, -1)
        inside = self._inside(x_mask, masks, rank) & (rank < masks.sum(-1)[:, None, :, None])
        return index.reshape(*x_mask.shape, -1), inside.reshape(*x_mask.shape, -1)
