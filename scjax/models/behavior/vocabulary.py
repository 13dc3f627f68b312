"""Motion tokens by k-disks: a vocabulary of changes of motion, to and from motions.

A motion is (forward, left, turn) [m, m, rad] of 0.2 s in the frame of the box before it. A token changes the motion
before. So 256 tokens resolve accelerations of 0.3 m/s^2 at every speed. k-disks: Philion, Peng, Fidler, "Trajeglish",
ICLR 2024, section 3.1.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float64, Int

from scjax.models.behavior.config import CLASSES
from scjax.scene import AgentType
from scjax.scene.scene import AnyArray

REST = 0.01  # m; vehicles and cyclists that move by less stand
_BOX = {AgentType.VEHICLE: (4.5, 2.0), AgentType.PEDESTRIAN: (0.8, 0.8), AgentType.CYCLIST: (1.8, 0.7)}  # m
_RANGE = {  # largest changes; larger ones are errors of the source
    AgentType.VEHICLE: (0.5, 0.15, 0.12),
    AgentType.PEDESTRIAN: (0.3, 0.3, 0.8),
    AgentType.CYCLIST: (0.4, 0.2, 0.25),
}
_BRAKING = (-0.08, -0.16, -0.24, -0.32)  # m; straight braking of vehicles and cyclists by 2 to 8 m/s^2 is always there
_FIRST_RADIUS, _SHRINK = 0.1, 0.85  # m, and factor to the next smaller radius
_MAX_SAMPLES = 40_000


def apply_change(
    base: Float[Array, "*b 3"], change: Float[Array, "*b 3"], kind: Int[AnyArray, "*b"]
) -> Float[Array, "*b 3"]:
    """The motion after ``base``. Vehicles and cyclists do not roll back; who hardly moves stands."""
    motion = base + change
    walks = kind == AgentType.PEDESTRIAN
    stands = (motion[..., 0] < REST) & ~walks
    return jnp.where(stands[..., None], 0.0, motion)


def motion_errors(
    first: Float[Array, "*b 3"],
    second: Float[Array, "*b 3"],
    length: Float[Array, "*b"],
    width: Float[Array, "*b"],
) -> Float[Array, "*b"]:
    """Mean distance between the four corners of a box after one motion and after another [m]."""
    d_x, d_y = first[..., 0] - second[..., 0], first[..., 1] - second[..., 1]
    d_cos = jnp.cos(first[..., 2]) - jnp.cos(second[..., 2])
    d_sin = jnp.sin(first[..., 2]) - jnp.sin(second[..., 2])
    total = jnp.zeros_like(d_x)
    for ahead, left in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        a, b = 0.5 * ahead * length, 0.5 * left * width
        e_x, e_y = d_x + a * d_cos - b * d_sin, d_y + a * d_sin + b * d_cos
        total = total + jnp.sqrt(e_x * e_x + e_y * e_y + 1e-12)
    return total / 4


def token_errors(
    vocabulary: Float[AnyArray, "C V 3"],
    base: Float[Array, "*b 3"],
    target: Float[Array, "*b 3"],
    length: Float[Array, "*b"],
    width: Float[Array, "*b"],
    kind: Int[Array, "*b"],
) -> Float[Array, "*b V"]:
    """How far a box ends from ``target`` by each token of its class [m]."""
    changes = jnp.asarray(vocabulary)[jnp.clip(kind, 0, CLASSES - 1)]
    shape = changes.shape[:-1]
    kinds = jnp.broadcast_to(kind[..., None], shape)
    motions = apply_change(jnp.broadcast_to(base[..., None, :], changes.shape), changes, kinds)
    targets = jnp.broadcast_to(target[..., None, :], changes.shape)
    sizes = (jnp.broadcast_to(size[..., None], shape) for size in (length, width))
    return motion_errors(motions, targets, *sizes)


def decode_tokens(
    vocabulary: Float[AnyArray, "C V 3"], base: Float[Array, "*b 3"], tokens: Int[Array, "*b"], kind: Int[Array, "*b"]
) -> Float[Array, "*b 3"]:
    """The motions that tokens stand for, after the motions ``base``."""
    change = jnp.asarray(vocabulary)[jnp.clip(kind, 0, CLASSES - 1), tokens]
    return apply_change(base, change, kind)


def build_vocabulary(
    changes: Float64[np.ndarray, "n 3"], kind: int, size: int, rng: np.random.Generator
) -> Float[np.ndarray, "V 3"]:
    """k-disks of changes of motion: no two tokens move a box to places nearer than a radius; the first is no change.

    The radius is the largest that leaves ``size`` tokens. Classes of which too little is known get random ones.

    Args:
      changes: of agents of one class.
      kind: ``AgentType``.
    """
    largest = np.array(_RANGE[AgentType(kind)])
    samples = changes[(np.abs(changes) < largest).all(1)]
    samples = samples[rng.permutation(len(samples))[:_MAX_SAMPLES]]
    if len(samples) < 4 * size:
        samples = np.concatenate([samples, np.clip(rng.normal(size=(8 * size, 3)) / 3, -1, 1) * largest])
    braking = () if kind == AgentType.PEDESTRIAN else _BRAKING
    fixed = np.zeros((1 + len(braking), 3))
    fixed[1:, 0] = braking
    fixed = fixed[:size]
    length, width = _BOX[AgentType(kind)]
    radius = _FIRST_RADIUS
    while True:
        tokens = _disks(np.concatenate([fixed, samples]), len(fixed), size, radius, 0.5 * np.hypot(length, width))
        if len(tokens) == size:
            return tokens.astype(np.float32)
        radius *= _SHRINK


def _disks(samples: np.ndarray, fixed: int, size: int, radius: float, arm: float) -> np.ndarray:
    """At most ``size`` samples further than ``radius`` from each other, in their order; the ``fixed`` first ones stay.

    The distance is that of the corners, which are ``arm`` [m] from the center, for small turns.
    """
    scaled = samples * [1.0, 1.0, arm]
    free = np.ones(len(samples), bool)
    chosen: list[int] = []
    for row in range(len(samples)):
        if len(chosen) == size:
            break
        if row >= fixed and not free[row]:
            continue
        chosen.append(row)
        apart = scaled - scaled[row]
        free &= (apart * apart).sum(1) > radius * radius
    return samples[chosen]
