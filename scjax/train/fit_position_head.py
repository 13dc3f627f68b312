"""Fits the position heads of a denoiser (``scjax.models.denoiser.position_head``) to a trained autoencoder."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float
from tqdm import tqdm

from scjax.data.loader import TrainingExample
from scjax.models.denoiser.position_head import AHEAD, ALONG, UNIT, PositionHead
from scjax.nn.functional import Params, functional
from scjax.scene import TILE_SIZE, Crop, Scene
from scjax.scene.per_type import PerType

_ROWS, _LEARNING_RATE = 512, 3e-3
_NOISE = 0.03  # standard deviation of the noise on the latents, whose own is 1
_VALIDATION_SHARE = 10  # one token in so many is left out of the fit and measures its error


@dataclasses.dataclass(frozen=True)
class FitOptions:
    """How long position heads are fitted.

    Attributes:
      batches: training batches that tokens are taken from; 80 of 32 scenes have some 40,000 lanes.
      steps: of the optimizer, ``_ROWS`` tokens each.
    """

    batches: int = 80
    steps: int = 4000


def position_targets(scene: Scene) -> dict[str, np.ndarray]:
    """The points that the heads estimate, per type: [B, slots, points, 2] from the window's center, in ``UNIT`` m."""
    agents, lanes = np.asarray(scene.agents), np.asarray(scene.lanes)
    is_forward = (np.asarray(scene.crop) == Crop.FORWARD)[:, None, None, None]
    window_center = np.where(is_forward, (TILE_SIZE / 2, 0.0), 0.0)
    center, ahead = agents[..., :2], AHEAD * agents[..., 4:6]
    points = {"agents": np.stack([center, center + ahead], -2), "lanes": lanes[..., ALONG, :2]}
    return {name: ((array - window_center) / UNIT).astype(np.float32) for name, array in points.items()}


def fit_position_heads(
    batches: Iterator[TrainingExample],
    latents_of: Callable[[Scene], PerType],
    key: jax.Array,
    options: FitOptions = FitOptions(),
) -> Params:
    """Parameters of ``Denoiser.position_heads``, fitted by least absolute errors; prints the errors [m].

    Least squares follow few large errors and leave offsets between linked ends inexact: 0.35 instead of 0.21 m
    (docs/results/low_noise.md at commit 3d14608).

    Args:
      batches: examples of the training split.
      latents_of: scenes -> latents, as the denoiser gets them.

    Returns:
      type ("agents", "lanes") -> parameters.
    """
    pairs = {"agents": [], "lanes": []}
    for _ in tqdm(range(options.batches), "latents of lanes and agents", disable=None):
        scene = next(batches).scene
        latents, targets = latents_of(scene), position_targets(scene)
        masks = {"agents": scene.agent_mask, "lanes": scene.lane_mask}
        for name, mask in masks.items():
            pairs[name].append((np.asarray(getattr(latents, name))[mask], targets[name][mask]))
    params = {}
    for number, (name, parts) in enumerate(pairs.items()):
        latents, targets = (np.concatenate(part) for part in zip(*parts, strict=True))
        params[name] = _fit_head(latents, targets, jax.random.fold_in(key, number), options)
    return params


def _fit_head(
    latents: Float[np.ndarray, "n d"], targets: Float[np.ndarray, "n p 2"], key: jax.Array, options: FitOptions
) -> Params:
    network = functional(lambda init: PositionHead(latents.shape[-1], targets.shape[-2], init=init))
    optimizer = optax.adam(optax.cosine_decay_schedule(_LEARNING_RATE, options.steps))
    left_out = len(latents) // _VALIDATION_SHARE
    fit_latents, fit_targets = jnp.asarray(latents[left_out:]), jnp.asarray(targets[left_out:])

    def error(params: Params, latents: Array, targets: Array) -> Array:
        return jnp.abs(network.apply(params, latents) - targets).mean()

    def step(state, number):
        params, moments = state
        row_key, noise_key = jax.random.split(jax.random.fold_in(key, number))
        rows = jax.random.randint(row_key, (_ROWS,), 0, len(fit_latents))
        noise = _NOISE * jax.random.normal(noise_key, (_ROWS, fit_latents.shape[-1]))
        gradients = jax.grad(error)(params, fit_latents[rows] + noise, fit_targets[rows])
        updates, moments = optimizer.update(gradients, moments)
        return (optax.apply_updates(params, updates), moments), None

    params = network.init(key)
    fit = jax.jit(lambda state: jax.lax.scan(step, state, jnp.arange(options.steps)))
    (params, _), _ = fit((params, optimizer.init(params)))
    estimates = network.apply(params, jnp.asarray(latents[:left_out]))
    errors = UNIT * np.linalg.norm(estimates - targets[:left_out], axis=-1)
    print(f"position head of {len(latents)} tokens: median error {np.median(errors):.2f} m on the tokens left out")
    return params
