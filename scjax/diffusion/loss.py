"""The training loss of the denoiser (official-spec §5.2, §5.5)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Real

from scjax.diffusion.guidance import Denoise
from scjax.diffusion.noise_level import NoiseLevel
from scjax.diffusion.process import estimate_x0, q_sample
from scjax.diffusion.process import target as target_of
from scjax.diffusion.schedule import Schedule
from scjax.diffusion.timestep_sampling import TimestepSampling, draw_levels
from scjax.models.denoiser.config import Prediction
from scjax.nn.cross_attention import AuxOutputs
from scjax.nn.functional import Functional, Params
from scjax.scene.per_type import PerType
from scjax.scene.pytree import pytree

LANE_WEIGHT = 10.0

Penalty = Callable[[PerType, NoiseLevel], Float[Array, " b"]]
"""(estimate of x_0, level) -> a number a scene that is added to its loss."""


@pytree
class LatentBatch:
    """What one training step of the denoiser consumes.

    Attributes:
      latents: clean normalised latents [B, tokens, latent] a kind, in token order.
      masks: True at valid tokens [B, tokens] a kind.
      known: True at tokens that are given, i.e. stay clean (the first half of partitioned scenes).
      label: rows of the label table.
      condition: features for ``encode_condition``, or None.
      has_condition: scenes whose features are real [B]; None: all.
      agent_weight: weights of the agents in the loss [B, agents] (field-of-view dropout); None: 1.
    """

    latents: PerType
    masks: PerType
    known: PerType
    label: Int[Array, " b"]
    condition: Any = None
    has_condition: Bool[Array, " b"] | None = None
    agent_weight: Float[Array, "b agents"] | None = None


def noised(
    level: NoiseLevel, clean: PerType, noise: PerType, known: PerType, prediction: Prediction = "noise"
) -> tuple[PerType, PerType]:  # fmt: skip
    """Network input and target: given tokens enter clean and have target 0, the others are noised."""
    target = target_of(level, clean, noise, prediction)
    x = jax.tree.map(
        lambda flag, x0, xt: jnp.where(flag[..., None], x0, xt), known, clean, q_sample(level, clean, noise)
    )
    return x, jax.tree.map(lambda flag, wanted: jnp.where(flag[..., None], 0, wanted), known, target)


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
    """Mean over scenes of 0.5 MSE(agents) + 10 * 0.5 MSE(lanes), each a mean over the scene's tokens and numbers.

    Args:
      denoise: (noisy latents, times) -> network output.
      level: of noise, one a scene.
      prediction: what ``denoise`` estimates.
      count_known: whether given tokens (target 0) count in the means, as in the release. Default: only tokens whose
        noise must be found; a scene in which every token of a kind is given has loss 0 there.
      penalty: added to the loss of every scene, from the estimate of x_0 with given tokens as they are.

    Returns:
      loss, and its terms a scene [B]: agent, lane, total, and penalty where there is one.
    """
    clean = jax.tree.map(lambda x, mask: jnp.where(mask[..., None], x, 0), clean, masks)
    x, target = noised(level, clean, noise, known, prediction)
    eps = denoise(x, jnp.asarray(level.time))
    counted = masks if count_known else jax.tree.map(lambda mask, flag: mask & ~flag, masks, known)
    weights = jax.tree.map(lambda mask, e: mask.astype(e.dtype), counted, eps)
    if agent_weight is not None:
        weights = weights.replace(agents=weights.agents * jnp.where(counted.agents, agent_weight, 0))
    error = jax.tree.map(_token_error, eps, target, masks)
    terms = jax.tree.map(lambda e, w: (e * w).sum(-1) / jnp.maximum(w.sum(-1), 1e-6), error, weights)
    total = terms.agents + LANE_WEIGHT * terms.lanes
    found = {"agent": terms.agents, "lane": terms.lanes}
    if penalty is not None:
        estimate = estimate_x0(level, x, eps, prediction)
        estimate = jax.tree.map(lambda flag, x0, guess: jnp.where(flag[..., None], x0, guess), known, clean, estimate)
        found["penalty"] = penalty(estimate, level)
        total = total + found["penalty"]
    return total.mean(), {**found, "total": total}


def training_loss(
    network: Functional,
    params: Params,
    schedule: Schedule,
    batch: LatentBatch,
    key: Array,
    *,
    null_label: int,
    prediction: Prediction = "noise",
    times: TimestepSampling = TimestepSampling(),  # noqa: B008 - frozen
    label_dropout: float | Float[Array, ""] = 0.1,
    condition_dropout: float | Float[Array, ""] = 0.1,
    count_known: bool = False,
    penalty: Penalty | None = None,
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    """One stochastic evaluation: times, noise and both dropouts are drawn from ``key``.

    Returns:
      loss, and the batch means of its terms: agent, lane, total (and penalty). What the conditioning trains by a loss
      of its own, if anything, is added to the loss and told as ``control``.
    """
    key_step, key_agents, key_lanes, key_label, key_condition = (jax.random.fold_in(key, i) for i in range(5))
    scenes = batch.label.shape
    level = draw_levels(key_step, len(batch.label), schedule, prediction, times)
    noise = jax.tree.map(
        lambda k, x: jax.random.normal(k, x.shape, x.dtype), PerType(agents=key_agents, lanes=key_lanes), batch.latents
    )
    label = jnp.where(jax.random.bernoulli(key_label, label_dropout, scenes), null_label, batch.label)
    cache = None
    if batch.condition is not None:
        dropped = jax.random.bernoulli(key_condition, condition_dropout, scenes)
        if batch.has_condition is not None:
            dropped = dropped | ~batch.has_condition
        cache = network.apply(params, batch.condition, dropped, method="encode_condition")

    aux: dict[str, AuxOutputs] = {}

    def denoise(z: PerType, t: Real[Array, " b"]) -> PerType:
        return network.apply(params, z, t, label, batch.masks, batch.known, cache, aux=aux)

    loss, terms = diffusion_loss(
        denoise, level, batch.latents, noise, batch.masks, batch.known,
        prediction=prediction, agent_weight=batch.agent_weight, count_known=count_known, penalty=penalty,
    )  # fmt: skip
    means = {name: term.mean() for name, term in terms.items()}
    own = [told.loss for told in aux.values() if told.loss is not None]
    if own:
        means["control"] = jnp.stack(own).sum()
        loss = loss + means["control"]
    return loss, means


def _token_error(
    eps: Float[Array, "b n d"], target: Float[Array, "b n d"], mask: Bool[Array, "b n"]
) -> Float[Array, "b n"]:  # fmt: skip
    difference = jnp.where(mask[..., None], eps - target, 0)
    return 0.5 * jnp.square(difference).mean(-1)
