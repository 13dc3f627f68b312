"""Sparse attention with asymmetric partitions (Mazare et al. 2025, SAAP; attention-variants §4.6).

Keys fall into buckets by k-means; a small classifier of the query, trained on the attention that the buckets receive,
says which few buckets it reads. The original approximates a trained model: here ``posthoc``, which is full attention
until ``saap_fit.fit`` has found buckets and classifier. ``joint`` trains both beside the model, by the loss in ``AuxOutputs``;
there the centroids follow the gradient of a soft k-means, which, unlike the moving average of the specification, needs
no state outside the parameters and no re-seeding. (For dense first steps, start a joint run from a posthoc model.)
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

from scjax.nn.attention import split_heads, weights
from scjax.nn.cpu.precision import Compute
from scjax.nn.cross_attention.base import AuxOutputs, ContextSpec, at_least, mean_over, one_of, only, readers
from scjax.nn.cross_attention.clusters import members, nearest, unit
from scjax.nn.cross_attention.gathered import attend_gathered, rows_at
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit
from scjax.scene.pytree import pytree

_TEMPERATURE = 0.1  # of the soft assignment that trains centroids


@dataclasses.dataclass(frozen=True)
class SaapOptions:
    """Options of ``Saap``.

    Attributes:
      buckets: of the keys of a head.
      probes: buckets that a query reads.
      router_width: hidden units of a head's classifier; 0 chooses max(64, width of a head).
      mode: "posthoc" or "joint", see above.
      form: "mask" computes all scores and masks them; "gather" only those in the buckets read.
      capacity: keys a bucket at most in the gather form, the rest being left out; 0 chooses twice the mean.
    """

    buckets: int = 32
    probes: int = 8
    router_width: int = 0
    mode: Literal["posthoc", "joint"] = "posthoc"
    form: Literal["mask", "gather"] = "mask"
    capacity: int = 0
    empty_is_zero: ClassVar[bool] = True

    def __post_init__(self):
        at_least(self, buckets=1, probes=1, router_width=0, capacity=0)
        one_of(self, mode=("posthoc", "joint"), form=("mask", "gather"))
        if self.probes > self.buckets:
            raise ValueError(
                f"SaapOptions.probes is {self.probes}, but there are {self.buckets} buckets to read: lower it"
            )


@pytree
class Buckets:
    """Keys and values, and the bucket of each key."""

    keys: Keys
    label: Int[Array, "b h m"]


class Saap(Projections):
    """y = W_o Attn(Q, K, V) where the key's bucket is among the query's ``probes`` most promising."""

    def __init__(
        self, options: SaapOptions, width: int, heads: int, spec: ContextSpec, *, init: ParamInit,
        compute: Compute = "float32",
    ):  # fmt: skip
        super().__init__(width, heads, init=init, compute=compute)
        size = width // heads
        self.router = Router(heads, size, options.router_width or max(64, size), options.buckets, init=init)
        self.centroids = nnx.Param(init.normal((heads, options.buckets, size), 1.0))
        self.fitted = nnx.Param(jnp.zeros(1))  # no gradient reaches it: ``saap_fit.fit`` sets it to 1
        self.options = options

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Buckets:
        """Keys, values and the buckets of the keys."""
        keys = self.project(context, mask)
        label = nearest(stop_gradient(self.real_keys(keys)), stop_gradient(self.centroids[...])[None])
        return Buckets(keys=keys, label=label)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Buckets
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read."""
        query, rows = self.query(x, x_mask), readers(x_mask, cache.keys.mask)
        joint = self.options.mode == "joint"
        routes = self.router(stop_gradient(split_heads(query, self.heads)))

        def sparse() -> tuple[Array, dict[str, Array]]:
            return self._sparse(query, routes, cache, rows)

        def dense() -> tuple[Array, dict[str, Array]]:
            told = {name: jnp.zeros((), query.dtype) for name in ("selected", "overflow")}
            return self.read(query, cache.keys), told | {"selected": jnp.ones((), query.dtype)}

        attended, metrics = sparse() if joint else jax.lax.cond(self.fitted[0] > 0.5, sparse, dense)
        loss = None
        if joint:
            shares = self.bucket_shares(query, cache)
            loss = router_loss(routes, shares, rows) + self._quantisation(cache.keys)
            chosen = _chosen(routes, cache, self.options)
            recall = jnp.where(chosen, shares, 0).sum(-1).mean(1)
            metrics = {**metrics, "recall": mean_over(rows, recall)}
        metrics = jax.tree.map(stop_gradient, metrics)
        return only(rows, self.out(attended)), AuxOutputs(loss=loss, metrics=metrics)

    def routing_loss(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], context: Float[Array, "b m d"],
        mask: Bool[Array, "b m"],
    ) -> Float[Array, ""]:  # fmt: skip
        """What the classifier is trained to lower."""
        query, cache = self.query(x, x_mask), self.encode(context, mask)
        routes = self.router(stop_gradient(split_heads(query, self.heads)))
        return router_loss(routes, self.bucket_shares(query, cache), readers(x_mask, mask))

    def bucket_shares(self, query: Float[Array, "b n d"], cache: Buckets) -> Float[Array, "b h n c"]:
        """The attention that each bucket gets if every key is read: what the classifier shall tell. No gradient."""
        towards = self.towards(stop_gradient(query))
        logits = towards * towards.shape[-1] ** -0.5 @ stop_gradient(cache.keys.key).swapaxes(2, 3)
        p, total = weights(stop_gradient(logits), cache.keys.mask[:, None, None])
        return (p / total) @ members(cache.label, cache.keys.mask, self.options.buckets, p.dtype)

    def _sparse(
        self, query: Float[Array, "b n d"], routes: Float[Array, "b h n c"], cache: Buckets, rows: Bool[Array, "b n"]
    ) -> tuple[Float[Array, "b n d"], dict[str, Float[Array, ""]]]:
        keys, options = cache.keys, self.options
        chosen = _chosen(routes, cache, options)
        sizes = members(cache.label, keys.mask, options.buckets, query.dtype).sum(2)  # [b h c]
        wanted = jnp.where(chosen, sizes[:, :, None], 0).sum(-1)
        if options.form == "mask":
            label = jnp.broadcast_to(cache.label[:, :, None], (*chosen.shape[:3], cache.label.shape[-1]))
            admitted = jnp.take_along_axis(chosen, label, -1) & keys.mask[:, None, None]
            attended, found = self.read(query, keys, admitted), wanted
        else:
            capacity = min(options.capacity or math.ceil(2 * keys.mask.shape[1] / options.buckets), keys.mask.shape[1])
            index, real = _contents(cache, options.buckets, capacity)
            probed = jax.lax.top_k(chosen.astype(jnp.int32), options.probes)[1]  # [b h n probes]
            admitted = rows_at(real, probed) & jnp.take_along_axis(chosen, probed, -1)[..., None]
            index, admitted = (x.reshape(*x.shape[:3], -1) for x in (rows_at(index, probed), admitted))
            attended = self.offset(attend_gathered(self.towards(query), keys.key, keys.value, index, admitted))
            found = admitted.sum(-1).astype(query.dtype)
        share = found / jnp.maximum(keys.mask.sum(-1), 1)[:, None, None]
        lost = 1 - found / jnp.maximum(wanted, 1)
        return attended, {
            "selected": mean_over(rows, share.mean(1)), "overflow": mean_over(rows, lost.mean(1))
        }  # fmt: skip

    def _quantisation(self, keys: Keys) -> Float[Array, ""]:
        """How badly the centroids stand for the keys: negative log-likelihood, up to a constant, of a mixture of
        directions around them (soft spherical k-means: Banerjee et al. 2005), which reaches empty buckets too.
        """
        similarity = unit(stop_gradient(self.real_keys(keys))) @ unit(self.centroids[...])[None].swapaxes(2, 3)
        likely = jax.nn.logsumexp(similarity / _TEMPERATURE, -1) * _TEMPERATURE
        return -mean_over(keys.mask, likely.mean(1))


class Router(nnx.Module):
    """One classifier a head: query -> SiLU layer -> logits of the buckets."""

    def __init__(self, heads: int, size: int, hidden: int, buckets: int, *, init: ParamInit):
        self.up = nnx.Param(init.uniform((heads, size, hidden), math.sqrt(6 / (size + hidden))))
        self.up_bias = nnx.Param(jnp.zeros((heads, 1, hidden)))
        self.down = nnx.Param(init.uniform((heads, hidden, buckets), math.sqrt(6 / (hidden + buckets))))
        self.down_bias = nnx.Param(jnp.zeros((heads, 1, buckets)))

    def __call__(self, query: Float[Array, "b h n d"]) -> Float[Array, "b h n c"]:
        hidden = jax.nn.silu(query @ self.up[...][None] + self.up_bias[...][None])
        return hidden @ self.down[...][None] + self.down_bias[...][None]


def router_loss(
    routes: Float[Array, "b h n c"], shares: Float[Array, "b h n c"], rows: Bool[Array, "b n"]
) -> Float[Array, ""]:
    """Cross-entropy of the classifier against the attention of the buckets, over real queries and heads."""
    entropy = -(stop_gradient(shares) * jax.nn.log_softmax(routes, -1)).sum(-1)
    return mean_over(rows, entropy.mean(1))


def _chosen(routes: Float[Array, "b h n c"], cache: Buckets, options: SaapOptions) -> Bool[Array, "b h n c"]:
    """The buckets that each query reads: the most promising of those that hold a readable key."""
    held = members(cache.label, cache.keys.mask, options.buckets).any(2)[:, :, None]
    best = jax.lax.top_k(jnp.where(held, stop_gradient(routes), -jnp.inf), options.probes)[1]
    return jax.nn.one_hot(best, options.buckets, dtype=bool).any(-2) & held


def _contents(cache: Buckets, buckets: int, capacity: int) -> tuple[Array, Array]:
    """Indices [b h c capacity] of the readable keys of each bucket, in order, and which entries are real."""
    inside = members(cache.label, cache.keys.mask, buckets, jnp.int32)
    place = jnp.take_along_axis(inside.cumsum(2) - 1, cache.label[..., None], -1)[..., 0]
    fits = cache.keys.mask[:, None] & (place < capacity)
    slot = jnp.where(fits, cache.label * capacity + place, buckets * capacity)  # out of range: dropped

    def fill(slot: Array) -> Array:
        return jnp.full(buckets * capacity, -1).at[slot].set(jnp.arange(len(slot)), mode="drop")

    index = jax.vmap(jax.vmap(fill))(slot).reshape(*slot.shape[:2], buckets, capacity)
    return jnp.maximum(index, 0), index >= 0
