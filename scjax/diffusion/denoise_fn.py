"""From the network to one ``denoise(z, t)`` for a batch of requests; what does not depend on the latents is done first.

That is the caches of the conditions, and the modulation of every step, of both branches of guidance: a handful of rows
a step would read all AdaLN weights for next to no work, all steps together read them once.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from scjax.diffusion.guidance import Denoise, Guidance, guided, join
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.context import ConditionFeatures, TextFeatures
from scjax.nn.functional import Functional, Params
from scjax.scene.per_type import PerType, generated_mask

MAX_PRECOMPUTED = 2**25
"""Numbers of modulation that may be held for all steps: 128 MiB in float32, on every device."""

Ahead = Callable[[Real[Array, " b"]], dict | None]
"""Times [B], all equal -> modulation, or None where the network is to compute it itself."""


def make_denoise_fn(
    network: Functional,
    config: DenoiserConfig,
    params: Params,
    label: Int[Array, " b"],
    masks: PerType,
    *,
    times: Real[Array | np.ndarray, " s"],
    known: PerType | None = None,
    features: ConditionFeatures | None = None,
    negative: TextFeatures | None = None,
    guidance: Guidance | None = None,
    weight: float | Float[Array, "*b"] = 1.0,
    most_ahead: int = MAX_PRECOMPUTED,
) -> Denoise:
    """``denoise`` of a batch, guided where ``guidance`` is given.

    Args:
      label: rows of the label table [B].
      masks: True at valid tokens [B, tokens] a kind.
      times: at which it will be asked, all scenes at the same.
      known: True at tokens that are given; None: none.
      features: of the condition; None leaves it out.
      negative: features of negative prompts, from which guidance leads away; None: from no condition.
      guidance: interval and rescaling; the weight is ``weight``, which may be traced, one for all or one a scene [B].
      most_ahead: numbers of modulation held for all times; with more, every step computes its own.
    """
    nobody, cache = jnp.zeros(label.shape, bool), None
    if features is not None:
        cache = network.apply(params, features, nobody, method="encode_condition")
    both_labels, both_masks, both_given, both_caches = label, masks, known, cache
    if guidance is not None:
        both_labels, both_masks = join(label, jnp.full_like(label, config.null_label)), join(masks, masks)
        both_given = None if known is None else join(known, known)
        if negative is not None:
            absent = ~jnp.asarray(negative.mask).any(-1)
            both_caches = join(cache, network.apply(params, negative, absent, method="encode_condition"))
        elif features is not None and config.attend_padding:  # else a stage needs no cache for "no condition"
            both_caches = join(cache, network.apply(params, features, ~nobody, method="encode_condition"))
    ahead = modulation_ahead(network, params, times, both_labels, both_masks, most_ahead)

    def both(z: PerType, t: Real[Array, " b"]) -> PerType:
        return network.apply(params, z, t, both_labels, both_masks, both_given, both_caches, ahead(t))

    if guidance is None:
        return both

    def one(z: PerType, t: Real[Array, " b"]) -> PerType:
        modulation = jax.tree.map(lambda x: x[: len(label)], ahead(t))
        return network.apply(params, z, t, label, masks, known, cache, modulation)

    generated = generated_mask(masks, known)
    return guided(
        both, weight, interval=guidance.interval, rescale=guidance.rescale, generated=generated, denoise_one=one
    )  # fmt: skip


def modulation_ahead(
    network: Functional, params: Params, times: Real[Array | np.ndarray, " s"], label: Int[Array, " b"], masks: PerType,
    most: int = MAX_PRECOMPUTED,
) -> Ahead:  # fmt: skip
    """Modulation of all times (ascending) at once, a row a time and scene, unless it has more than ``most`` numbers."""
    counts = jax.tree.map(lambda mask: mask.sum(-1, dtype=jnp.int32), masks)

    def every(params: Params) -> dict:
        steps, scenes = len(times), len(label)
        repeated = jax.tree.map(lambda x: jnp.tile(x, steps), (label, counts))
        rows = network.apply(params, jnp.repeat(jnp.asarray(times), scenes), *repeated, method="modulation")
        return jax.tree.map(lambda x: x.reshape(steps, scenes, *x.shape[1:]), rows)

    if sum(leaf.size for leaf in jax.tree.leaves(jax.eval_shape(every, params))) > most:
        return lambda t: None
    table = every(params)

    def looked_up(t: Real[Array, " b"]) -> dict:
        row = jnp.searchsorted(jnp.asarray(times), t[0])
        return jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, row, keepdims=False), table)

    return looked_up
