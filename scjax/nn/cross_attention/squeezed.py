"""Squeezed attention (Hooper et al. 2024, arXiv:2411.09688; attention-variants §4.9).

The keys of a fixed context are clustered once, and each head reads only keys of the clusters closest to its queries.
The original is applied to a trained model. So is the rule "threshold" here: the parameter ``threshold`` starts at -1,
where every key is read and nothing is clustered; ``calibrate`` finds its value. Training may then continue (the
specification's "finetune"). The rule "top" reads a fixed share of the keys (of equal scores, the first), and can be
trained from the first step.
"""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
from flax import nnx
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from scjax.nn.attention import attend_heads, split_heads
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
from scjax.nn.cross_attention.clusters import kmeans, members, nearest
from scjax.nn.cross_attention.gathered import attend_gathered, first_of, rows_at
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit
from scjax.scene.pytree import pytree


@dataclasses.dataclass(frozen=True)
class SqueezedOptions(CrossAttentionOptions):
    """Options of ``Squeezed``.

    Attributes:
      clusters: number of clusters per scene and head.
      keep: share of the keys to read (under rule "threshold", the target of its calibration).
      rule: "threshold" or "top", see above.
      pool: "mean" selects one set of keys per head, by the mean score over the scene's queries; "none" one per query.
      iterations: iterations of k-means.
      form: "mask" computes all scores and masks them; "gather" computes only those of the selected keys.
      capacity: largest number of keys of the gather form under rule "threshold" (the best are read); 0 chooses twice
        the share ``keep``.
    """

    name: ClassVar[str] = "squeezed"

    clusters: int = 32
    keep: float = 0.3
    rule: Literal["threshold", "top"] = "threshold"
    pool: Literal["mean", "none"] = "mean"
    iterations: int = 10
    form: Literal["mask", "gather"] = "mask"
    capacity: int = 0

    def __post_init__(self):
        at_least(self, clusters=1, iterations=0, capacity=0)
        one_of(self, rule=("threshold", "top"), pool=("mean", "none"), form=("mask", "gather"))
        if not 0 < self.keep <= 1:
            raise ValueError(f"SqueezedOptions.keep is a share of the keys, in (0, 1], not {self.keep!r}")

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> Squeezed:
        """The module of this mechanism."""
        return Squeezed(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        cluster = self.iterations * context * self.clusters * width
        read = queries * self.clusters * width + 2 * queries * self.keep * context * width
        return Work(2 * context * width**2 + cluster, 2 * queries * width**2 + read)


@pytree
class Clusters:
    """Per scene and head: the cluster of each key, and each cluster's mean and number of members."""

    label: Int[Array, "b h m"]
    mean: Float[Array, "b h c d"]
    size: Float[Array, "b h c"]


@pytree
class SqueezedCache:
    """Keys, values and clusters."""

    keys: Keys
    clusters: Clusters


class Squeezed(Projections):
    """y = W_o Attn(Q, K, V) over the keys of the clusters with the largest shares."""

    def __init__(
        self,
        options: SqueezedOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        super().__init__(width, heads, init=init, compute=compute)
        self.threshold = nnx.Param(jnp.full(1, -1.0))  # no gradient reaches it
        self.options = options

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> SqueezedCache:
        """Keys, values and, if keys are selected, clusters."""
        keys = self.project(context, mask)
        real, count = stop_gradient(self.real_keys(keys)), self.options.clusters

        def unused() -> Clusters:
            mean = jnp.zeros((*real.shape[:2], count, real.shape[3]), real.dtype)
            return Clusters(label=jnp.zeros(real.shape[:3], jnp.int32), mean=mean, size=mean[..., 0])

        clusters = self._if_used(lambda: cluster(real, mask, count, self.options.iterations), unused)
        return SqueezedCache(keys=keys, clusters=clusters)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: SqueezedCache
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read from the selected keys."""
        query, rows = self.query(x, x_mask), active_rows(x_mask, cache.keys.mask)
        attended, share = self._if_used(
            lambda: self._sparse(query, rows, cache),
            lambda: (self.read(query, cache.keys), jnp.ones((), query.dtype)),
        )
        return mask_rows(rows, self.out(attended)), AuxOutputs(metrics={"selected": stop_gradient(share)})

    def scores(
        self, query: Float[Array, "b n d"], rows: Bool[Array, "b n"], cache: SqueezedCache
    ) -> Float[Array, "b h #n m"]:
        """Each key's attention share by its cluster's mean, times the number of readable keys: 1 is an even share.

        The factor makes prompts of different lengths comparable. -inf at masked keys.
        """
        mask, clusters = cache.keys.mask, cache.clusters
        shares = cluster_shares(stop_gradient(split_heads(query, self.heads)), clusters)
        if self.options.pool == "mean":
            total = jnp.where(rows[:, None, :, None], shares, 0).sum(2, keepdims=True)
            shares = total / jnp.maximum(rows.sum(-1), 1)[:, None, None, None]
        shares = jnp.take_along_axis(shares, clusters.label[:, :, None], -1)
        count = mask.sum(-1).astype(shares.dtype)[:, None, None, None]
        return jnp.where(mask[:, None, None], count * shares, -jnp.inf)

    def selected(self, scores: Float[Array, "b h n m"], mask: Bool[Array, "b m"]) -> Bool[Array, "b h n m"]:
        """The keys to read: at least one, if any is readable."""
        if self.options.rule == "threshold":
            best = scores == scores.max(-1, keepdims=True)
            return mask[:, None, None] & (best | (scores > self.threshold[...].astype(scores.dtype)[None, None, None]))
        num_kept = jnp.ceil(self.options.keep * mask.sum(-1) - 1e-4)[:, None, None, None]
        rank = jnp.argsort(jnp.argsort(-scores, -1, stable=True), -1)
        return mask[:, None, None] & (rank < num_kept)

    def _sparse(
        self, query: Float[Array, "b n d"], rows: Bool[Array, "b n"], cache: SqueezedCache
    ) -> tuple[Float[Array, "b n d"], Float[Array, ""]]:
        keys, scores = cache.keys, self.scores(query, rows, cache)
        selected = self.selected(scores, keys.mask)
        if self.options.form == "mask":
            attended = self.read(query, keys, selected)
        else:
            tokens, scaled_query = keys.mask.shape[1], self.scaled_query(query)
            share = self.options.keep * (1 if self.options.rule == "top" else 2)
            capacity = min(self.options.capacity or math.ceil(share * tokens), tokens)
            index, selected = first_of(selected, capacity, scores)
            if self.options.pool == "mean":
                key, value = (rows_at(part, index[:, :, 0]) for part in (keys.key, keys.value))
                attended = attend_heads(scaled_query, key, value, selected)
            else:
                attended = attend_gathered(scaled_query, keys.key, keys.value, index, selected)
            attended = self.offset(attended)
        share = selected.sum(-1).mean(1) / jnp.maximum(keys.mask.sum(-1, keepdims=True), 1)
        return attended, mean_over(rows, jnp.broadcast_to(share, rows.shape).astype(query.dtype))

    def _if_used(self, used, unused):
        """The result of ``used``, or of ``unused`` while the threshold keeps every key."""
        if self.options.rule == "top":
            return used()
        return jax.lax.cond(self.threshold[0] >= 0, used, unused)


def cluster(keys: Float[Array, "b h m d"], mask: Bool[Array, "b m"], count: int, iterations: int) -> Clusters:
    """k-means by direction; the means are those of the keys themselves, zero for clusters without members."""
    label = nearest(keys, kmeans(keys, mask, count, iterations))
    inside = members(label, mask, count, keys.dtype)
    size = inside.sum(2)
    return Clusters(label=label, mean=inside.swapaxes(2, 3) @ keys / jnp.maximum(size, 1)[..., None], size=size)


def cluster_shares(query: Float[Array, "b h n d"], clusters: Clusters) -> Float[Array, "b h n c"]:
    """S_i = exp(s q.C_i) / sum_j N_j exp(s q.C_j): the share of one key, which sums to one over the keys."""
    logits = query * query.shape[-1] ** -0.5 @ clusters.mean.swapaxes(2, 3)
    real = clusters.size[:, :, None] > 0
    logits = jnp.where(real, logits, -1e30)
    p = jnp.where(real, jnp.exp(logits - logits.max(-1, keepdims=True)), 0)
    total = (p * clusters.size[:, :, None]).sum(-1, keepdims=True)
    return p / jnp.where(total > 0, total, 1)
