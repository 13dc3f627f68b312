"""Kinds of tokens as vectors that are added to their embeddings."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Float, Int

from scjax.models.denoiser.kinds import digits_of


class KindEmbedding(nnx.Module):
    """The sum of one learned vector for each digit; zero for ``NO_KIND``. A fresh one adds nothing at all."""

    def __init__(self, sizes: Sequence[int], width: int):
        self.vectors = nnx.Param(jnp.zeros((sum(sizes), width)))
        self.sizes = tuple(sizes)

    def __call__(self, kinds: Int[Array, "b tokens"]) -> Float[Array, "b tokens width"]:
        starts = [0, *itertools.accumulate(self.sizes)]
        rows = jnp.stack([start + digit for start, digit in zip(starts, digits_of(kinds, self.sizes), strict=False)])
        total = self.vectors[...][rows].sum(0)
        return jnp.where(kinds[..., None] >= 0, total, 0)
