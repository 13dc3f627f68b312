"""The autoencoder's training loss and its reconstruction errors (official-spec §2.5).

Every term is a mean over the elements of one scene, and the loss is the mean over scenes. With ``typical_counts``
elements of crowded scenes weigh as much as those of others. Padding and values that the source did not record (known
flags False) are left out; if everything is known, the terms are the official ones.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from scjax.models.autoencoder.outputs import Decoded, Posterior
from scjax.models.codec import NormalizedScene
from scjax.scene import AnyArray, Crop, Link

_COUNT_TOLERANCE = 3  # largest error of a lane count that the log counts as correct


@dataclasses.dataclass(frozen=True, kw_only=True)
class LossWeights:
    """Weights of the terms. Defaults are official; the release has no ``lane_connections`` and ``lane_steps``."""

    agent_states: float = 1.0
    lane_points: float = 10.0
    agent_type: float = 1.0
    lane_type: float = 1.0
    lane_connection: float = 10.0
    kl_agent: float = 0.01
    kl_lane: float = 0.01
    lane_count: float = 0.1
    lane_connections: float = 0.0
    lane_steps: float = 0.0


OFFICIAL_WEIGHTS = LossWeights()


def loss(
    decoded: Decoded,
    posterior: Posterior,
    tokens: NormalizedScene,
    weights: LossWeights = OFFICIAL_WEIGHTS,
    *,
    official_lane_count: bool = True,
    balanced_links: bool = False,
    typical_counts: tuple[float, ...] = (),
) -> tuple[Float[AnyArray, ""], dict[str, Float[AnyArray, ""]]]:
    """The mean total over scenes, and the mean of every term for the log.

    Args:
      official_lane_count: use the lane-count cross-entropy in all but CENTERED scenes (FORWARD scenes have target 0);
        otherwise in PARTITIONED scenes only.
      balanced_links: average the mean cross-entropy of each link class present in a scene, instead of all pairs, most
        of which are unrelated.
      typical_counts: (agents, lanes), or () for none. Scales a scene's coordinate terms (``agent_states`` and those of
        lanes) by its number of agents or lanes over this number, so every element has the same weight.

    Raises:
      ValueError: ``typical_counts`` that are not two numbers above 0.
    """
    options = {
        "official_lane_count": official_lane_count,
        "balanced_links": balanced_links,
        "typical_counts": typical_counts,
    }
    decoded, posterior, tokens = jax.tree.map(jnp.asarray, (decoded, posterior, tokens))
    terms = scene_losses(decoded, posterior, tokens, weights, **options)
    counted = _counted(tokens, official_lane_count)
    miss = jnp.abs(posterior.lane_count_logits.argmax(-1) - lanes_after(tokens))
    logged = {name: value.mean() for name, value in terms.items()}
    logged["kl"] = logged["kl_agent"] + logged["kl_lane"]
    logged["lane_count_over_counted"] = _mean(terms["lane_count"], counted)
    logged["lane_count_accuracy"] = _mean((miss <= _COUNT_TOLERANCE).astype(logged["total"].dtype), counted)
    return logged["total"], logged


def scene_losses(
    decoded: Decoded,
    posterior: Posterior,
    tokens: NormalizedScene,
    weights: LossWeights = OFFICIAL_WEIGHTS,
    *,
    official_lane_count: bool = True,
    balanced_links: bool = False,
    typical_counts: tuple[float, ...] = (),
) -> dict[str, Float[AnyArray, " b"]]:
    """Every unweighted term and the weighted sum ``total`` per scene [B]. Options as for ``loss``."""
    decoded, posterior, tokens = jax.tree.map(jnp.asarray, (decoded, posterior, tokens))
    lane_mask, agent_mask = tokens.lane_mask, tokens.agent_mask
    pairs = lane_mask[:, :, None] & lane_mask[:, None]
    agent_known = tokens.agent_known & agent_mask[..., None]
    lane_known = jnp.broadcast_to((tokens.lane_known & lane_mask[..., None])[:, :, None], tokens.lanes.shape)
    lane_type_known = tokens.lane_type_known & lane_mask
    counts = lanes_after(tokens)
    count_entropy = _cross_entropy(posterior.lane_count_logits, counts, jnp.ones_like(counts, bool))
    has_lane_types = decoded.lane_type_logits.shape[-1] > 0
    terms = {
        "agent_states": _mean_per_scene(_absolute_error(decoded.agents, tokens.agents, agent_known), agent_known),
        "lane_points": _mean_per_scene(_absolute_error(decoded.lanes, tokens.lanes, lane_known), lane_known),
        "agent_type": _mean_per_scene(
            _cross_entropy(decoded.agent_type_logits, tokens.agent_types, agent_mask), agent_mask
        ),
        "lane_type": _mean_per_scene(
            _cross_entropy(decoded.lane_type_logits, tokens.lane_types, lane_type_known), lane_type_known
        )
        if has_lane_types
        else jnp.zeros_like(count_entropy),
        "lane_connection": _link_entropy(decoded.link_logits, tokens.links, pairs, balanced_links),
        "kl_agent": _scene_kl(posterior.mean.agents, posterior.logvar.agents, agent_mask),
        "kl_lane": _scene_kl(posterior.mean.lanes, posterior.logvar.lanes, lane_mask),
        "lane_count": jnp.where(_counted(tokens, official_lane_count), count_entropy, 0.0),
        "lane_connections": _connection_error(decoded.lanes, tokens, pairs)
        if weights.lane_connections
        else jnp.zeros_like(count_entropy),
        "lane_steps": _step_error(decoded.lanes, tokens.lanes, lane_known)
        if weights.lane_steps
        else jnp.zeros_like(count_entropy),
    }
    shares = {}
    if typical_counts:
        if len(typical_counts) != 2 or min(typical_counts) <= 0:
            raise ValueError(
                f"typical_counts must be two numbers above 0, of agents and of lanes, or (), not {typical_counts}"
            )
        of_agents, of_lanes = (
            mask.sum(-1) / n for mask, n in zip((agent_mask, lane_mask), typical_counts, strict=True)
        )
        shares = {
            "agent_states": of_agents,
            **dict.fromkeys(("lane_points", "lane_connections", "lane_steps"), of_lanes),
        }
    total = sum(getattr(weights, name) * shares.get(name, 1.0) * term for name, term in terms.items())
    return terms | {"total": jnp.asarray(total)}


def lanes_after(tokens: NormalizedScene) -> Int[AnyArray, " b"]:
    """Number of lanes at x > 0 of PARTITIONED scenes; 0 in others."""
    after = (tokens.lane_mask & ~tokens.lane_behind).sum(-1)
    return jnp.where(tokens.crop == Crop.PARTITIONED, after, 0)


def scene_errors(decoded: Decoded, tokens: NormalizedScene) -> dict[str, Float[AnyArray, " b"]]:
    """Reconstruction errors of each scene, in unit coordinates.

    Returns:
      lane_points, agent_positions: mean Euclidean distance in x, y over points and over agents;
      agent_headings: mean angle in radians; agent_states: mean |difference| over known entries;
      agent_types, lane_types: share of correct classes over agents, and over lanes whose class is known;
      link_hits, link_true, link_predicted: numbers of related pairs of different lanes that are predicted with the
      correct class, that exist, and that are predicted (sums over scenes give recall, precision and F1).
    """
    decoded, tokens = jax.tree.map(jnp.asarray, (decoded, tokens))
    lane_mask, agent_mask = tokens.lane_mask, tokens.agent_mask
    dtype = decoded.lanes.dtype
    gaps = _norm(decoded.lanes[..., :2] - jnp.where(lane_mask[..., None, None], tokens.lanes[..., :2], 0.0))
    agents = jnp.where(agent_mask[..., None], tokens.agents, 0.0)
    known = tokens.agent_known & agent_mask[..., None]
    turn = jnp.arctan2(
        decoded.agents[..., 5] * agents[..., 4] - decoded.agents[..., 4] * agents[..., 5],
        decoded.agents[..., 4] * agents[..., 4] + decoded.agents[..., 5] * agents[..., 5],
    )
    lane_type_known = tokens.lane_type_known & lane_mask
    right_agents = (decoded.agent_type_logits.argmax(-1) == tokens.agent_types).astype(dtype)
    result = {
        "lane_points": _mean_per_scene(gaps, jnp.broadcast_to(lane_mask[..., None], gaps.shape)),
        "agent_positions": _mean_per_scene(_norm(decoded.agents[..., :2] - agents[..., :2]), agent_mask),
        "agent_headings": _mean_per_scene(jnp.abs(turn), agent_mask),
        "agent_states": _mean_per_scene(_absolute_error(decoded.agents, tokens.agents, known), known),
        "agent_types": _mean_per_scene(right_agents, agent_mask),
    }
    if decoded.lane_type_logits.shape[-1]:
        right_lanes = (decoded.lane_type_logits.argmax(-1) == tokens.lane_types).astype(dtype)
        result["lane_types"] = _mean_per_scene(right_lanes, lane_type_known)
    pairs = lane_mask[:, :, None] & lane_mask[:, None] & ~jnp.eye(lane_mask.shape[1], dtype=bool)[None]
    links = decoded.link_logits.argmax(-1)
    result["link_hits"] = (pairs & (links == tokens.links) & (links > 0)).sum((1, 2)).astype(dtype)
    result["link_true"] = (pairs & (tokens.links > 0)).sum((1, 2)).astype(dtype)
    result["link_predicted"] = (pairs & (links > 0)).sum((1, 2)).astype(dtype)
    return result


def _counted(tokens: NormalizedScene, official: bool) -> Bool[AnyArray, " b"]:
    crop = tokens.crop
    return crop != Crop.CENTERED if official else crop == Crop.PARTITIONED


def _norm(difference: Float[AnyArray, "*b 2"]) -> Float[AnyArray, "*b"]:
    return jnp.sqrt(jnp.square(difference).sum(-1))


def _absolute_error(prediction: AnyArray, target: AnyArray, known: AnyArray) -> AnyArray:
    """|prediction - target|, zero (gradient too) where unknown."""
    return jnp.abs(jnp.where(known, prediction - jnp.where(known, target, 0.0), 0.0))


def _cross_entropy(
    logits: Float[AnyArray, "*b k"], classes: Int[AnyArray, "*b"], mask: Bool[AnyArray, "*b"]
) -> Float[AnyArray, "*b"]:
    """In at least float32; zero where masked."""
    logits = logits.astype(jnp.promote_types(logits.dtype, jnp.float32))
    # A product with one-hots, not a lookup: the gradient of a lookup is a serial scatter on a CPU.
    selected = (jax.nn.one_hot(classes, logits.shape[-1], dtype=logits.dtype) * logits).sum(-1)
    return jnp.where(mask, jax.nn.logsumexp(logits, -1) - selected, 0.0)


def _link_entropy(logits: AnyArray, links: AnyArray, pairs: AnyArray, balanced: bool) -> Float[AnyArray, " b"]:
    entropy = _cross_entropy(logits, links, pairs)
    if not balanced:
        return _mean_per_scene(entropy, pairs)
    classes = range(logits.shape[-1])
    members = jnp.stack([(pairs & (links == c)).sum((1, 2)) for c in classes], -1)
    sums = jnp.stack([jnp.where(links == c, entropy, 0.0).sum((1, 2)) for c in classes], -1)
    return _mean_of(sums / jnp.maximum(members, 1).astype(sums.dtype), members > 0)


def _connection_error(lanes: AnyArray, tokens: NormalizedScene, pairs: AnyArray) -> Float[AnyArray, " b"]:
    """Mean |difference| of the step from the end of a lane to the start of each that follows it.

    Errors shared by both lanes cost nothing: this term measures whether roads stay connected.
    """
    known = tokens.lane_known & tokens.lane_mask[..., None]
    followed = (pairs & (tokens.links == Link.PREDECESSOR))[..., None] & known[:, :, None] & known[:, None]
    true = jnp.where(known[:, :, None], tokens.lanes, 0.0)

    def steps(points):
        return points[:, None, :, 0] - points[:, :, None, -1]

    return _mean_per_scene(_absolute_error(steps(lanes), steps(true), followed), followed)


def _step_error(prediction: AnyArray, target: AnyArray, known: AnyArray) -> Float[AnyArray, " b"]:
    """Mean |difference| of the step from each point of a lane to the next: penalizes jitter."""
    true, known = jnp.diff(jnp.where(known, target, 0.0), axis=2), known[:, :, 1:]
    return _mean_per_scene(_absolute_error(jnp.diff(prediction, axis=2), true, known), known)


def _scene_kl(
    mean: Float[AnyArray, "b n d"], logvar: Float[AnyArray, "b n d"], mask: Bool[AnyArray, "b n"]
) -> Float[AnyArray, " b"]:
    divergence = -0.5 * (1 + logvar - jnp.square(mean) - jnp.exp(logvar)).mean(-1)
    return _mean_per_scene(divergence, mask)


def _mean_per_scene(values: Float[AnyArray, "b ..."], mask: Bool[AnyArray, "b ..."]) -> Float[AnyArray, " b"]:
    """Mean over the elements of each scene where ``mask`` is True; 0 without any."""
    batch = values.shape[0]
    return _mean_of(values.reshape(batch, -1), mask.reshape(batch, -1))


def _mean_of(values: Float[AnyArray, "b n"], mask: Bool[AnyArray, "b n"]) -> Float[AnyArray, " b"]:
    # Counted as integers: float32 ones of a large scene would round.
    number = jnp.maximum(mask.sum(-1), 1).astype(values.dtype)
    return jnp.where(mask, values, 0.0).sum(-1) / number


def _mean(values: Float[AnyArray, " b"], mask: Bool[AnyArray, " b"]) -> Float[AnyArray, ""]:
    return _mean_of(values[None], mask[None])[0]
