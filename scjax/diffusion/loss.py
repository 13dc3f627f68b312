"""The training loss of the denoiser (official-spec §5.2, §5.5)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Real

from scjax.diffusion.defaults import DEFAULT_CONDITION_DROPOUT, DEFAULT_LABEL_DROPOUT, LANE_LOSS_WEIGHT
from scjax.diffusion.guidance import Denoise
from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.process import estimate_x0, prediction_target, q_sample
from scjax.diffusion.schedule import DiffusionSchedule
from scjax.diffusion.timestep_sampling import TimestepSampling, sample_noise_levels
from scjax.models.denoiser.config import Prediction
from scjax.models.denoiser.kinds import NO_KIND
from scjax.nn import random
from scjax.nn.cross_attention import AuxOutputs
from scjax.nn.functional import Functional, Params
from scjax.scene.per_type import PerType
from scjax.scene.pytree import pytree

_CONDITION_ALONE, _REQUEST_ALONE = 0.2, 0.3
"""Shares of scenes without their request, or without their condition, where a batch has both."""

Penalty = Callable[[PerType, NoiseLevel], Float[Array, " b"]]
"""(x0 estimate [B, tokens, latent] per type, noise level [B]) -> penalty per scene [B], added to the loss."""


@pytree
class LatentBatch:
    """Input of one training step of the denoiser.

    Attributes:
      latents: clean normalized latents [B, tokens, latent] per type, in token order.
      masks: True at valid tokens [B, tokens] per type.
      known: True at known tokens, which stay clean (the first half of partitioned scenes) [B, tokens] per type.
      label: rows of the label table [B].
      attributes: features of requests [B, features], or None.
      kinds: of the tokens [B, tokens] per type, which the network is given, or None.
      condition: features for ``encode_condition``, or None.
      has_condition: True for scenes with a condition [B]; None: all.
      agent_weight: weights of the agents in the loss [B, agents] (field-of-view dropout); None: 1.
    """

    latents: PerType
    masks: PerType
    known: PerType
    label: Int[Array, " b"]
    attributes: Float[Array, "b features"] | None = None
    kinds: PerType | None = None
    condition: Any = None
    has_condition: Bool[Array, " b"] | None = None
    agent_weight: Float[Array, "b agents"] | None = None


def noise_latents(
    level: NoiseLevel, clean: PerType, noise: PerType, known: PerType, prediction: Prediction = "noise"
) -> tuple[PerType, PerType]:
    """Network input and target [B, tokens, latent] per type. Known tokens enter clean and have target 0."""
    target = prediction_target(level, clean, noise, prediction)
    x = jax.tree.map(
        lambda mask, x0, xt: jnp.where(mask[..., None], x0, xt), known, clean, q_sample(level, clean, noise)
    )
    return x, jax.tree.map(lambda mask, value: jnp.where(mask[..., None], 0, value), known, target)


def diffusion_loss(
    denoise: Denoise,
    level: NoiseLevel,
    clean: PerType,
    noise: PerType,
    masks: PerType,
    known: PerType,
    *,
    prediction: Prediction = "noise",
    agent_weight: Float[Array, "b agents"] | None = None,
    count_known: bool = False,
    penalty: Penalty | None = None,
) -> tuple[Float[Array, ""], dict[str, Float[Array, " b"]]]:
    """Mean over scenes of 0.5 MSE(agents) + 10 * 0.5 MSE(lanes). Each MSE is a mean over tokens and latents.

    Args:
      denoise: (noisy latents, times [B]) -> network output.
      level: one noise level per scene [B].
      clean, noise: x0 and eps [B, tokens, latent] per type.
      masks, known: as in ``LatentBatch``.
      prediction: what ``denoise`` returns.
      agent_weight: as in ``LatentBatch``.
      count_known: True: known tokens (target 0) count in the means, as in the official release. False: only generated
        tokens count, and a type whose tokens are all known has loss 0.
      penalty: added to the loss of every scene. Its x0 estimate holds known tokens unchanged.

    Returns:
      The loss, and its terms per scene [B]: agent, lane, total and, with a penalty, penalty.
    """
    clean = jax.tree.map(lambda x, mask: jnp.where(mask[..., None], x, 0), clean, masks)
    x, target = noise_latents(level, clean, noise, known, prediction)
    output = denoise(x, jnp.asarray(level.time))
    counted = masks if count_known else jax.tree.map(lambda mask, flag: mask & ~flag, masks, known)
    weights = jax.tree.map(lambda mask, e: mask.astype(e.dtype), counted, output)
    if agent_weight is not None:
        weights = weights.replace(agents=weights.agents * jnp.where(counted.agents, agent_weight, 0))
    error = jax.tree.map(_token_error, output, target, masks)
    means = jax.tree.map(lambda e, w: (e * w).sum(-1) / jnp.maximum(w.sum(-1), 1e-6), error, weights)
    total = means.agents + LANE_LOSS_WEIGHT * means.lanes
    terms = {"agent": means.agents, "lane": means.lanes}
    if penalty is not None:
        estimate = estimate_x0(level, x, output, prediction)
        estimate = jax.tree.map(lambda mask, x0, x: jnp.where(mask[..., None], x0, x), known, clean, estimate)
        terms["penalty"] = penalty(estimate, level)
        total = total + terms["penalty"]
    return total.mean(), {**terms, "total": total}


def training_loss(
    network: Functional,
    params: Params,
    schedule: DiffusionSchedule,
    batch: LatentBatch,
    key: Array,
    *,
    null_label: int,
    prediction: Prediction = "noise",
    timestep_sampling: TimestepSampling = TimestepSampling(),  # noqa: B008 - frozen
    label_dropout: float | Float[Array, ""] = DEFAULT_LABEL_DROPOUT,
    condition_dropout: float | Float[Array, ""] = DEFAULT_CONDITION_DROPOUT,
    kind_dropout: float | Float[Array, ""] = DEFAULT_CONDITION_DROPOUT,
    count_known: bool = False,
    penalty: Penalty | None = None,
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """Loss of one batch with random noise levels, noise and dropout from ``key``, one for the batch or one per scene.

    Args:
      null_label: row of the label table that replaces dropped labels.
      label_dropout: share of scenes without their label.
      condition_dropout: share without condition and attributes. Where a batch has both, more scenes are without one of
        them.
      kind_dropout: for each type of tokens, the share of scenes without kinds.
      prediction, count_known, penalty: as in ``diffusion_loss``.

    Returns:
      The loss, and batch means of its terms: agent, lane, total, and penalty if there is one. Losses of the cross
      attention itself are added to the loss and reported as ``cross_attention``.
    """
    key_level, key_agents, key_lanes, key_label, key_condition, key_kinds = (random.fold_in(key, i) for i in range(6))
    scenes = batch.label.shape
    level = sample_noise_levels(key_level, len(batch.label), schedule, prediction, timestep_sampling)
    noise = jax.tree.map(
        lambda k, x: random.normal(k, x.shape, x.dtype), PerType(agents=key_agents, lanes=key_lanes), batch.latents
    )
    label = jnp.where(random.bernoulli(key_label, label_dropout, scenes), null_label, batch.label)
    dropped = random.bernoulli(key_condition, condition_dropout, scenes)
    attributes, dropped = _drop_one(batch, dropped, key_condition)
    kinds = batch.kinds
    if kinds is not None:
        keys = PerType(agents=random.fold_in(key_kinds, 0), lanes=random.fold_in(key_kinds, 1))
        kinds = jax.tree.map(
            lambda k, kind: jnp.where(random.bernoulli(k, kind_dropout, scenes)[:, None], NO_KIND, kind),
            keys,
            kinds,
        )
    cache = None
    if batch.condition is not None:
        if batch.has_condition is not None:
            dropped = dropped | ~batch.has_condition
        cache = network.apply(params, batch.condition, dropped, method="encode_condition")

    aux: dict[str, AuxOutputs] = {}

    def denoise(z: PerType, t: Real[Array, " b"]) -> PerType:
        options = {"attributes": attributes, "kinds": kinds, "aux": aux}
        return network.apply(params, z, t, label, batch.masks, batch.known, cache, **options)

    loss, terms = diffusion_loss(
        denoise,
        level,
        batch.latents,
        noise,
        batch.masks,
        batch.known,
        prediction=prediction,
        agent_weight=batch.agent_weight,
        count_known=count_known,
        penalty=penalty,
    )
    means = {name: term.mean() for name, term in terms.items()}
    aux_losses = [outputs.loss for outputs in aux.values() if outputs.loss is not None]
    if aux_losses:
        means["cross_attention"] = jnp.stack(aux_losses).sum()
        loss = loss + means["cross_attention"]
    return loss, means


def _drop_one(
    batch: LatentBatch, dropped: Bool[Array, " b"], key: Array
) -> tuple[Float[Array, "b features"] | None, Bool[Array, " b"]]:
    """The requests, zeros where they are dropped, and the scenes whose condition is dropped.

    Args:
      dropped: scenes without both. Of the others some are without one, if the batch has both.
    """
    if batch.attributes is None:
        return None, dropped
    no_request = dropped
    if batch.condition is not None:
        shares = random.uniform(random.fold_in(key, 0), dropped.shape)
        no_request = dropped | (shares < _CONDITION_ALONE)
        dropped = dropped | (shares > 1 - _REQUEST_ALONE)
    return jnp.where(no_request[:, None], 0, batch.attributes), dropped


def _token_error(
    output: Float[Array, "b n d"], target: Float[Array, "b n d"], mask: Bool[Array, "b n"]
) -> Float[Array, "b n"]:
    difference = jnp.where(mask[..., None], output - target, 0)
    return 0.5 * jnp.square(difference).mean(-1)
