"""Builds ``denoise(z, t)`` from the network and a batch of conditions.

What does not depend on the latents is computed once, before the sampling loop: the condition caches of both guidance
branches, and the AdaLN modulation of all steps. One step alone would read all AdaLN weights for a few rows.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Real

from scjax.diffusion.defaults import MAX_PRECOMPUTED
from scjax.diffusion.guidance import Denoise, Guidance, concat_branches, with_guidance
from scjax.models.denoiser.config import DenoiserConfig
from scjax.models.denoiser.context import ConditionFeatures, TextFeatures
from scjax.nn.functional import Functional, Params
from scjax.scene.per_type import PerType, generated_mask

ModulationFn = Callable[[Real[Array, " b"]], dict | None]
"""Times [B], all equal -> precomputed modulation, or None: the network computes it itself."""


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
    guidance_scale: float | Float[Array, "*b"] = 1.0,
    max_precomputed: int = MAX_PRECOMPUTED,
) -> Denoise:
    """``denoise`` of a batch of scenes, with classifier-free guidance if ``guidance`` is set.

    Args:
      label: rows of the label table [B].
      masks: True at valid tokens [B, tokens] per type.
      times: all times of the sampler [S], ascending. All scenes share one time in each call.
      known: True at known tokens [B, tokens] per type; None: none.
      features: features of the condition; None: unconditional.
      negative: features of negative prompts, which replace the unconditional branch; None: no negative prompts.
      guidance: interval and rescaling. Its scale is not used.
      guidance_scale: scale for all scenes or per scene [B]; may be traced.
      max_precomputed: limit on precomputed modulation values; above it, every step computes its own modulation.
    """
    keep_condition, cache = jnp.zeros(label.shape, bool), None
    if features is not None:
        cache = network.apply(params, features, keep_condition, method="encode_condition")
    both_labels, both_masks, both_known, both_caches = label, masks, known, cache
    if guidance is not None:
        both_labels = concat_branches(label, jnp.full_like(label, config.null_label))
        both_masks = concat_branches(masks, masks)
        both_known = None if known is None else concat_branches(known, known)
        if negative is not None:
            absent = ~jnp.asarray(negative.mask).any(-1)
            both_caches = concat_branches(cache, network.apply(params, negative, absent, method="encode_condition"))
        elif features is not None and config.attend_padding:  # otherwise "no condition" needs no cache
            dropped = network.apply(params, features, ~keep_condition, method="encode_condition")
            both_caches = concat_branches(cache, dropped)
    modulation_at = precompute_modulation(network, params, times, both_labels, both_masks, max_precomputed)

    def denoise_both(z: PerType, t: Real[Array, " b"]) -> PerType:
        return network.apply(params, z, t, both_labels, both_masks, both_known, both_caches, modulation_at(t))

    if guidance is None:
        return denoise_both

    def denoise_conditional(z: PerType, t: Real[Array, " b"]) -> PerType:
        modulation = jax.tree.map(lambda x: x[: len(label)], modulation_at(t))
        return network.apply(params, z, t, label, masks, known, cache, modulation)

    return with_guidance(
        denoise_both,
        guidance_scale,
        interval=guidance.interval,
        rescale=guidance.rescale,
        generated=generated_mask(masks, known),
        denoise_conditional=denoise_conditional,
    )


def precompute_modulation(
    network: Functional,
    params: Params,
    times: Real[Array | np.ndarray, " s"],
    label: Int[Array, " b"],
    masks: PerType,
    max_precomputed: int = MAX_PRECOMPUTED,
) -> ModulationFn:
    """Computes the modulation of all ``times`` (ascending) in one batch, if it has at most ``max_precomputed`` values.

    Returns:
      Function of times [B] that looks up the modulation. It returns None if there would be too many values.
    """
    counts = jax.tree.map(lambda mask: mask.sum(-1, dtype=jnp.int32), masks)

    def modulation_table(params: Params) -> dict:
        steps, scenes = len(times), len(label)
        repeated = jax.tree.map(lambda x: jnp.tile(x, steps), (label, counts))
        rows = network.apply(params, jnp.repeat(jnp.asarray(times), scenes), *repeated, method="modulation")
        return jax.tree.map(lambda x: x.reshape(steps, scenes, *x.shape[1:]), rows)

    if sum(leaf.size for leaf in jax.tree.leaves(jax.eval_shape(modulation_table, params))) > max_precomputed:
        return lambda t: None
    table = modulation_table(params)

    def modulation_at(t: Real[Array, " b"]) -> dict:
        row = jnp.searchsorted(jnp.asarray(times), t[0])
        return jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, row, keepdims=False), table)

    return modulation_at
