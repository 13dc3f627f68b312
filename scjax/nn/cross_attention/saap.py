"""Sparse attention with asymmetric partitions (Mazare et al. 2025, SAAP; attention-variants §4.6).

k-means divides the keys into buckets. A small classifier of the query, the router, selects the few buckets to read;
its targets are the shares of full attention that fall on the buckets. The original approximates a trained model. Mode
"posthoc" does the same: full attention until ``calibrate.fit_saap`` has fitted buckets and router. Mode "joint" trains
both together with the model, by the loss in ``AuxOutputs``. There the centroids follow the gradient of a soft k-means;
unlike the specification's moving average, it needs no state outside the parameters and no re-seeding.
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
from scjax.nn.cross_attention.clusters import members, nearest, unit
from scjax.nn.cross_attention.projections import Keys, Projections
from scjax.nn.init import ParamInit
from scjax.scene.pytree import pytree

_TEMPERATURE = 0.1  # of the soft assignment that trains centroids


@dataclasses.dataclass(frozen=True)
class SaapOptions(CrossAttentionOptions):
    """Options of ``Saap``.

    Attributes:
      buckets: of the keys of a head.
      probes: buckets that a query reads.
      router_width: hidden units of a head's classifier; 0 chooses max(64, width of a head).
      mode: "posthoc" or "joint", see above.
    """

    name: ClassVar[str] = "saap"

    buckets: int = 32
    probes: int = 8
    router_width: int = 0
    mode: Literal["posthoc", "joint"] = "posthoc"

    def __post_init__(self):
        at_least(self, buckets=1, probes=1, router_width=0)
        one_of(self, mode=("posthoc", "joint"))
        if self.probes > self.buckets:
            raise ValueError(
                f"SaapOptions.probes is {self.probes}, but there are {self.buckets} buckets to read: lower it"
            )

    def build(
        self, width: int, heads: int, spec: ContextSpec, *, init: ParamInit, compute: Compute = "float32"
    ) -> Saap:
        """The module of this mechanism."""
        return Saap(self, width, heads, spec, init=init, compute=compute)

    def work(self, width: int, heads: int, spec: ContextSpec, queries: int, context: int) -> Work:
        """Multiply-adds of one module and scene."""
        size = width // heads
        route = queries * heads * (self.router_width or max(64, size)) * (size + self.buckets)
        read = 2 * queries * self.probes * context / self.buckets * width
        return Work(2 * context * width**2 + context * self.buckets * width, 2 * queries * width**2 + route + read)


@pytree
class Buckets:
    """Keys and values, and the bucket of each key."""

    keys: Keys
    label: Int[Array, "b h m"]


class Saap(Projections):
    """y = W_o Attn(Q, K, V) where the key's bucket is among the query's ``probes`` most promising."""

    def __init__(
        self,
        options: SaapOptions,
        width: int,
        heads: int,
        spec: ContextSpec,
        *,
        init: ParamInit,
        compute: Compute = "float32",
    ):
        super().__init__(width, heads, init=init, compute=compute)
        size = width // heads
        self.router = Router(heads, size, options.router_width or max(64, size), options.buckets, init=init)
        self.centroids = nnx.Param(init.normal((heads, options.buckets, size), 1.0))
        self.fitted = nnx.Param(jnp.zeros(1))  # no gradient reaches it: ``calibrate.fit_saap`` sets it to 1
        self.options = options

    def encode(self, context: Float[Array, "b m d"], mask: Bool[Array, "b m"]) -> Buckets:
        """Keys, values and the buckets of the keys."""
        keys = self.project(context, mask)
        label = nearest(stop_gradient(self.real_keys(keys)), stop_gradient(self.centroids[...])[None])
        return Buckets(keys=keys, label=label)

    def attend(
        self, x: Float[Array, "b n d"], x_mask: Bool[Array, "b n"], cache: Buckets
    ) -> tuple[Float[Array, "b n d"], AuxOutputs]:
        """What the scene tokens read from their buckets."""
        query, rows = self.query(x, x_mask), active_rows(x_mask, cache.keys.mask)
        joint = self.options.mode == "joint"
        logits = self.router(stop_gradient(split_heads(query, self.heads)))

        def sparse() -> tuple[Array, dict[str, Array]]:
            return self._sparse(query, logits, cache, rows)

        def dense() -> tuple[Array, dict[str, Array]]:
            return self.read(query, cache.keys), {"selected": jnp.ones((), query.dtype)}

        attended, metrics = sparse() if joint else jax.lax.cond(self.fitted[0] > 0.5, sparse, dense)
        loss = None
        if joint:
            shares = self.bucket_shares(query, cache)
            loss = router_loss(logits, shares, rows) + self._quantization_loss(cache.keys)
            recall = jnp.where(_probed_buckets(logits, cache, self.options), shares, 0).sum(-1).mean(1)
            metrics = {**metrics, "recall": mean_over(rows, recall)}
        metrics = jax.tree.map(stop_gradient, metrics)
        return mask_rows(rows, self.out(attended)), AuxOutputs(loss=loss, metrics=metrics)

    def routing_loss(
        self,
        x: Float[Array, "b n d"],
        x_mask: Bool[Array, "b n"],
        context: Float[Array, "b m d"],
        mask: Bool[Array, "b m"],
    ) -> Float[Array, ""]:
        """The loss that trains the router."""
        query, cache = self.query(x, x_mask), self.encode(context, mask)
        logits = self.router(stop_gradient(split_heads(query, self.heads)))
        return router_loss(logits, self.bucket_shares(query, cache), active_rows(x_mask, mask))

    def bucket_shares(self, query: Float[Array, "b n d"], cache: Buckets) -> Float[Array, "b h n c"]:
        """The share of full attention that falls on each bucket: the router's target. No gradient."""
        scaled_query = self.scaled_query(stop_gradient(query))
        logits = scaled_query * scaled_query.shape[-1] ** -0.5 @ stop_gradient(cache.keys.key).swapaxes(2, 3)
        p, total = weights(stop_gradient(logits), cache.keys.mask[:, None, None])
        return (p / total) @ members(cache.label, cache.keys.mask, self.options.buckets, p.dtype)

    def _sparse(
        self, query: Float[Array, "b n d"], logits: Float[Array, "b h n c"], cache: Buckets, rows: Bool[Array, "b n"]
    ) -> tuple[Float[Array, "b n d"], dict[str, Float[Array, ""]]]:
        """All scores, masked by bucket: faster at every measured size than gathering keys per query."""
        keys, options = cache.keys, self.options
        probed = _probed_buckets(logits, cache, options)
        sizes = members(cache.label, keys.mask, options.buckets, query.dtype).sum(2)  # [b h c]
        label = jnp.broadcast_to(cache.label[:, :, None], (*probed.shape[:3], cache.label.shape[-1]))
        admitted = jnp.take_along_axis(probed, label, -1) & keys.mask[:, None, None]
        num_keys = jnp.where(probed, sizes[:, :, None], 0).sum(-1)
        share = num_keys / jnp.maximum(keys.mask.sum(-1), 1)[:, None, None]
        return self.read(query, keys, admitted), {"selected": mean_over(rows, share.mean(1))}

    def _quantization_loss(self, keys: Keys) -> Float[Array, ""]:
        """Negative log-likelihood of the keys, up to a constant, under a mixture of directions around the centroids.

        This is soft spherical k-means (Banerjee et al. 2005); its gradient reaches empty buckets too.
        """
        similarity = unit(stop_gradient(self.real_keys(keys))) @ unit(self.centroids[...])[None].swapaxes(2, 3)
        log_likelihood = jax.nn.logsumexp(similarity / _TEMPERATURE, -1) * _TEMPERATURE
        return -mean_over(keys.mask, log_likelihood.mean(1))


class Router(nnx.Module):
    """One classifier per head: query -> SiLU layer -> logits of the buckets."""

    def __init__(self, heads: int, size: int, hidden: int, buckets: int, *, init: ParamInit):
        self.up = nnx.Param(init.uniform((heads, size, hidden), math.sqrt(6 / (size + hidden))))
        self.up_bias = nnx.Param(jnp.zeros((heads, 1, hidden)))
        self.down = nnx.Param(init.uniform((heads, hidden, buckets), math.sqrt(6 / (hidden + buckets))))
        self.down_bias = nnx.Param(jnp.zeros((heads, 1, buckets)))

    def __call__(self, query: Float[Array, "b h n d"]) -> Float[Array, "b h n c"]:
        hidden = jax.nn.silu(query @ self.up[...][None] + self.up_bias[...][None])
        return hidden @ self.down[...][None] + self.down_bias[...][None]


def router_loss(
    logits: Float[Array, "b h n c"], shares: Float[Array, "b h n c"], rows: Bool[Array, "b n"]
) -> Float[Array, ""]:
    """Cross-entropy of the router against the attention shares of the buckets, over real queries and heads."""
    entropy = -(stop_gradient(shares) * jax.nn.log_softmax(logits, -1)).sum(-1)
    return mean_over(rows, entropy.mean(1))


def _probed_buckets(logits: Float[Array, "b h n c"], cache: Buckets, options: SaapOptions) -> Bool[Array, "b h n c"]:
    """The buckets that each query reads: those of the largest logits that contain a readable key."""
    occupied = members(cache.label, cache.keys.mask, options.buckets).any(2)[:, :, None]
    best = jax.lax.top_k(jnp.where(occupied, stop_gradient(logits), -jnp.inf), options.probes)[1]
    return jax.nn.one_hot(best, options.buckets, dtype=bool).any(-2) & occupied
