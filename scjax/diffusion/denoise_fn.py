"""Builds ``denoise(z, t)`` from the network and a batch of conditions, in two parts.

``prepare_denoiser_inputs`` computes what does not depend on the latents, once before the sampling loop: the condition
caches of both guidance branches, and the AdaLN modulation of all steps (one step alone would read all AdaLN weights for
a few rows). ``denoise_fn`` is what runs in every step.
"""

from __future__ import annotations

from typing import Any

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
from scjax.scene.pytree import Replaceable, pytree


@pytree
class Branch(Replaceable):
    """One branch of guidance: what the network reads besides latents and time; all [B, ...].

    Attributes:
      label: rows of the label table.
      attributes: features of requests; None: nothing is requested.
      cache: of the condition (``Denoiser.encode_condition``); None: no condition.
      modulation: AdaLN chunks at all times of a sampler [B, S, ...]; None: the network computes them in every step.
    """

    label: Int[Array, " b"]
    attributes: Float[Array, "b a"] | None
    cache: Any
    modulation: Any


@pytree
class DenoiserInputs:
    """What the network reads in every step of a batch of scenes.

    Attributes:
      masks: True at valid tokens [B, tokens] per type.
      known: True at known tokens [B, tokens] per type; None: none.
      kinds: of the tokens [B, tokens] per type, see ``Denoiser.__call__``; None: none is given.
      conditional, unconditional: the branches of guidance; without guidance the second is None.
    """

    masks: PerType
    known: PerType | None
    kinds: PerType | None
    conditional: Branch
    unconditional: Branch | None


def prepare_denoiser_inputs(
    network: Functional,
    config: DenoiserConfig,
    params: Params,
    label: Int[Array, " b"],
    masks: PerType,
    *,
    times: Real[Array | np.ndarray, " s"],
    guided: bool,
    known: PerType | None = None,
    attributes: Float[Array, "b a"] | None = None,
    negative_attributes: Float[Array, "b a"] | None = None,
    kinds: PerType | None = None,
    features: ConditionFeatures | None = None,
    negative: TextFeatures | None = None,
    max_precomputed: int = MAX_PRECOMPUTED,
) -> DenoiserInputs:
    """What does not depend on the latents, computed once before the sampling loop.

    Args:
      label: rows of the label table [B].
      masks: True at valid tokens [B, tokens] per type.
      times: all times of the sampler [S], ascending.
      guided: whether there are two branches.
      known: True at known tokens [B, tokens] per type; None: none.
      attributes: features of requests [B, features]; None: nothing is requested.
      negative_attributes: those of the unconditional branch; None: nothing is requested there.
      kinds: of the tokens [B, tokens] per type, in both branches; None: none is given.
      features: features of the condition; None: unconditional.
      negative: features of negative prompts, which replace the unconditional branch; None: no negative prompts.
      max_precomputed: limit on precomputed modulation values; above it, every step computes its own modulation.
    """
    cache = null_cache = None
    if features is not None:
        keep_condition = jnp.zeros(label.shape, bool)
        cache = network.apply(params, features, keep_condition, method="encode_condition")
        if guided and negative is not None:
            absent = ~jnp.asarray(negative.mask).any(-1)
            null_cache = network.apply(params, negative, absent, method="encode_condition")
        elif guided and config.attend_padding:  # otherwise "no condition" needs no cache
            null_cache = network.apply(params, features, ~keep_condition, method="encode_condition")
    null_label = jnp.full_like(label, config.null_label)
    no_request = None if attributes is None else jnp.zeros_like(attributes)
    if attributes is not None and negative_attributes is not None:
        no_request = negative_attributes
    rows = (label, masks, attributes)
    if guided:
        rows = concat_branches(rows, (null_label, masks, no_request))
    table = _modulation_table(network, params, times, *rows, max_precomputed)
    scenes = len(label)
    return DenoiserInputs(
        masks=masks,
        known=known,
        kinds=kinds,
        conditional=Branch(
            label=label, attributes=attributes, cache=cache, modulation=jax.tree.map(lambda x: x[:scenes], table)
        ),
        unconditional=Branch(
            label=null_label,
            attributes=no_request,
            cache=null_cache,
            modulation=jax.tree.map(lambda x: x[scenes:], table),
        )
        if guided
        else None,
    )


def denoise_fn(
    network: Functional,
    params: Params,
    inputs: DenoiserInputs,
    *,
    times: Real[Array | np.ndarray, " s"],
    guidance: Guidance | None = None,
    guidance_scale: float | Float[Array, "*b"] = 1.0,
    image_scale: float | Float[Array, "*b"] | None = None,
) -> Denoise:
    """``denoise`` of a batch of scenes, with classifier-free guidance if ``guidance`` is set.

    Args:
      inputs: from ``prepare_denoiser_inputs``, with two branches if ``guidance`` is set.
      times: all times of the sampler [S], ascending. All scenes share one time in each call.
      guidance: interval and rescaling. Its scale is not used.
      guidance_scale, image_scale: scales for all scenes or per scene [B], as in ``Guidance``; they may be traced.
    """

    tokens = inputs.masks, inputs.known, inputs.kinds

    def evaluate(branch: Branch, tokens: tuple, z: PerType, t: Real[Array, " b"]) -> PerType:
        masks, known, kinds = tokens
        context = branch.cache, branch.modulation, branch.attributes
        return network.apply(params, z, t, branch.label, masks, known, *context, kinds)

    def denoise(z: PerType, t: Real[Array, " b"]) -> PerType:
        return evaluate(_at_time(inputs.conditional, times, t), tokens, z, t)

    if guidance is None:
        return denoise
    unconditional = inputs.unconditional
    assert unconditional is not None

    def denoise_both(z: PerType, t: Real[Array, " b"]) -> PerType:
        conditional = _at_time(inputs.conditional, times, t)
        branch, all_tokens = _concat(conditional, _at_time(unconditional, times, t)), concat_branches(tokens, tokens)
        if image_scale is not None:
            branch = _concat(branch, conditional.replace(cache=unconditional.cache))
            all_tokens = concat_branches(all_tokens, tokens)
        return evaluate(branch, all_tokens, z, t)

    return with_guidance(
        denoise_both,
        guidance_scale,
        image_scale=image_scale,
        interval=guidance.interval,
        rescale=guidance.rescale,
        generated=generated_mask(inputs.masks, inputs.known),
        denoise_conditional=denoise,
    )


def _at_time(branch: Branch, times: Real[Array | np.ndarray, " s"], t: Real[Array, " b"]) -> Branch:
    """The branch with the modulation [B, ...] at one time."""
    row = jnp.searchsorted(jnp.asarray(times), t[0])
    table = branch.modulation
    return branch.replace(
        modulation=jax.tree.map(lambda x: jax.lax.dynamic_index_in_dim(x, row, 1, keepdims=False), table)
    )


def _concat(conditional: Branch, unconditional: Branch) -> Branch:
    """Both branches as one of 2 B scenes. A condition of the first half alone needs no cache for the second."""
    cache = conditional.cache
    if unconditional.cache is not None:
        cache = concat_branches(cache, unconditional.cache)
    return Branch(
        label=concat_branches(conditional.label, unconditional.label),
        attributes=concat_branches(conditional.attributes, unconditional.attributes),
        cache=cache,
        modulation=concat_branches(conditional.modulation, unconditional.modulation),
    )


def _modulation_table(
    network: Functional,
    params: Params,
    times: Real[Array | np.ndarray, " s"],
    label: Int[Array, " b"],
    masks: PerType,
    attributes: Float[Array, "b a"] | None,
    max_precomputed: int,
) -> Any:
    """The modulation of all ``times`` in one batch [B, S, ...]; None if it has more than ``max_precomputed`` values."""
    counts = jax.tree.map(lambda mask: mask.sum(-1, dtype=jnp.int32), masks)

    def table(params: Params) -> dict:
        steps, scenes = len(times), len(label)
        repeated = jax.tree.map(lambda x: jnp.tile(x, (steps, *[1] * (x.ndim - 1))), (label, counts, attributes))
        rows = network.apply(params, jnp.repeat(jnp.asarray(times), scenes), *repeated, method="modulation")
        return jax.tree.map(lambda x: x.reshape(steps, scenes, *x.shape[1:]).swapaxes(0, 1), rows)

    values = sum(leaf.size for leaf in jax.tree.leaves(jax.eval_shape(table, params)))
    return table(params) if values <= max_precomputed else None
