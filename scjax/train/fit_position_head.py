"""Fits what reads points off latents (scjax.models.denoiser.position_head) to a trained autoencoder."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float
from tqdm import tqdm

from scjax.data.loader import Example
from scjax.models.denoiser.position_head import AHEAD, ALONG, UNIT, PositionHead
from scjax.nn.functional import Params, functional
from scjax.scene import TILE_SIZE, Crop, Scene
from scjax.scene.per_type import PerType

_BATCHES = 80  # of the training stream: some 40,000 lanes
_STEPS, _AT_ONCE, _RATE = 4000, 512, 3e-3
_NOISE = 0.03  # spread of what is added to the latents, whose own is 1


def points_of(scene: Scene) -> dict[str, np.ndarray]:
    """Anchors of every slot [B, slots, points, 2] from the middle of the window, in units of ``UNIT``, by kind."""
    agents, lanes = np.asarray(scene.agents), np.asarray(scene.lanes)
    ahead_of_ego = (np.asarray(scene.crop) == Crop.FORWARD)[:, None, None, None]
    middle = np.where(ahead_of_ego, (TILE_SIZE / 2, 0.0), 0.0)
    centre, ahead = agents[..., :2], AHEAD * agents[..., 4:6]
    found = {"agents": np.stack([centre, centre + ahead], -2), "lanes": lanes[..., ALONG, :2]}
    return {kind: ((points - middle) / UNIT).astype(np.float32) for kind, points in found.items()}


def fit_anchors(batches: Iterator[Example], latents_of: Callable[[Scene], PerType], key: jax.Array) -> Params:
    """Parameters of ``Denoiser.anchors``.

    Args:
      batches: examples of the training split; latents_of: latents of a scene as the denoiser gets them.

    Returns:
      kind -> parameters, fitted by least squares. Errors in metres are printed.
    """
    pairs = {"agents": [], "lanes": []}
    for _ in tqdm(range(_BATCHES), "latents of lanes and agents", disable=None):
        scene = next(batches).scene
        latents, wanted = latents_of(scene), points_of(scene)
        masks = {"agents": scene.agent_mask, "lanes": scene.lane_mask}
        for kind, mask in masks.items():
            pairs[kind].append((np.asarray(getattr(latents, kind))[mask], wanted[kind][mask]))
    return {
        kind: _fitted(*(np.concatenate(part) for part in zip(*pairs[kind], strict=True)), jax.random.fold_in(key, k))
        for k, kind in enumerate(pairs)
    }


def _fitted(latents: Float[np.ndarray, "n d"], points: Float[np.ndarray, "n p 2"], key: jax.Array) -> Params:
    network = functional(lambda init: PositionHead(latents.shape[-1], points.shape[-2], init=init))
    optimizer = optax.adam(optax.cosine_decay_schedule(_RATE, _STEPS))
    held = len(latents) // 10
    known, wanted = jnp.asarray(latents[held:]), jnp.asarray(points[held:])

    def error(params: Params, latents: Array, points: Array) -> Array:
        return jnp.square(network.apply(params, latents) - points).mean()

    def step(state, number):
        params, moments = state
        rows, noise = jax.random.split(jax.random.fold_in(key, number))
        chosen = jax.random.randint(rows, (_AT_ONCE,), 0, len(known))
        seen = known[chosen] + _NOISE * jax.random.normal(noise, (_AT_ONCE, known.shape[-1]))
        updates, moments = optimizer.update(jax.grad(error)(params, seen, wanted[chosen]), moments)
        return (optax.apply_updates(params, updates), moments), None

    params = network.init(key)
    (params, _), _ = jax.jit(lambda state: jax.lax.scan(step, state, jnp.arange(_STEPS)))(
        (params, optimizer.init(params))
    )
    away = UNIT * np.linalg.norm(network.apply(params, jnp.asarray(latents[:held])) - points[:held], axis=-1)
    print(f"anchors of {len(latents)} tokens: off by {np.median(away):.2f} m (median of the tenth held back)")
    return params
