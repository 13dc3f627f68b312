"""Sliding-window attention: each query reads the keys around one place of the context (attention-variants §4.7).

FlashAttention-2 (Dao 2023, arXiv:2307.08691) aligns query and key positions at their last tokens. For cross-attention
the window better slides along the context as queries go along theirs; both are here. Positions are ranks among valid
tokens, and the rule is one inequality of integers, so that padding and rounding never move a window.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, Literal

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, at_least, mean_over, one_of, only, readers
from scjax.nn.cross_attention.gathered import attend_gathered, first_of
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit


@dataclasses.dataclass(frozen=True)
class WindowedOptions:
    """Options of ``Windowed``.

    Attributes:
      window: keys read on each side of the centre; 0 chooses 64, or 32 a modality.
      alignment: where the window of query i of n lies among m keys: "diagonal" (i + 1/2) m / n - 1/2, "diagonal_rev"
        the same from the other end, "fa2" i + m - n (queries and keys end together; a query may reach no key).
      per_modality: whether every grid of an image has a window of its own, around the same cell.
      form: "mask" computes all scores and masks them; "gather" only those in the window.
    """

    window: int = 0
    alignment: Literal["diagonal", "diagonal_rev", "fa2"] = "diagonal"
    per_modality: bool = True
    form: Literal["mask", "gather"] = "mask"
    empty_is_zero: ClassVar[bool] = True

    def __post_init__(self):
        at_least(self, window=0)
        one_of(self, alignment=("diagonal", "diagonal_rev", "fa2"), form=("mask", "gather"))


class Windowed(Projections):
    """y = W_o Attn(Q, K, V) where |rank of the key - centre of the query| <= window; 0 where no key is in it."""

    def __init__(
        self, options: WindowedOptions, width: int, heads: int, spec: ContextSpec, *, init: ParamInit,
        compute: Compute = "float32",
    ):  # fmt: skip
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
        """What the scene tokens read in their windows."""
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
            attended = self.offset(attend_gathered(self.towards(query), cache.key, cache.value, index, mask))
        rows = readers(x_mask, cache.mask)
        share = admitted.sum(-1) / jnp.maximum(cache.mask.sum(-1, keepdims=True), 1)
        return only(rows & admitted.any(-1), self.out(attended)), AuxOutputs(
            metrics={"selected": mean_over(rows, share)}
        )

    def _inside(
        self, x_mask: Bool[Array, "b n"], masks: Bool[Array, "b parts cells"], rank: Int[Array, "b n_or_1 parts w"]
    ) -> Bool[Array, "b n parts w"]:
        """Whether the key of such a rank is in the window: |2 n rank - 2 n centre| <= 2 n window."""
        centre, count = self._centre(x_mask, masks)
        return jnp.abs(2 * count * rank - centre) <= 2 * count * self.window

    def _centre(self, x_mask: Bool[Array, "b n"], masks: Bool[Array, "b parts cells"]) -> tuple[Array, Array]:
        """2 n times the centre [b n parts 1] of each window, and n (at least 1) [b 1 1 1]."""
        rank = (jnp.cumsum(x_mask, -1) - 1)[:, :, None, None]
        count = jnp.maximum(x_mask.sum(-1), 1)[:, None, None, None]
        keys = masks.sum(-1)[:, None, :, None]
        if self.options.alignment == "fa2":
            return 2 * count * (rank + keys - count), count
        centre = (2 * rank + 1) * keys - count
        return centre if self.options.alignment == "diagonal" else 2 * count * (keys - 1) - centre, count

    def _window(self, x_mask: Bool[Array, "b n"], masks: Bool[Array, "b parts cells"]) -> tuple[Array, Array]:
        """Indices [b n w] of the keys in each window, and which of them are in it."""
        cells = masks.shape[-1]
        width = min(2 * self.window + 1, cells)
        centre, count = self._centre(x_mask, masks)
        first = -((2 * count * self.window - centre) // (2 * count))  # the least rank in the window
        rank = jnp.clip(first, 0, cells - width) + jnp.arange(width)[None, None, None]
        position, _ = first_of(masks, cells)  # rank -> cell
        position = position + cells * jnp.arange(self.parts)[None, :, None]
        index = jnp.take_along_axis(position[:, None], rank, -1)
        inside = self._inside(x_mask, masks, rank) & (rank < masks.sum(-1)[:, None, :, None])
        return index.reshape(*x_mask.shape, -1), inside.reshape(*x_mask.shape, -1)
