"""Spherical k-means of attention keys, by scene and head (Dhillon & Modha 2001; attention-variants §4.6, §4.9)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped


def unit(x: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
    """x / |x|; the zero vector stays, with a finite gradient."""
    return x * jax.lax.rsqrt(jnp.square(x).sum(-1, keepdims=True) + 1e-12)


def nearest(x: Float[Array, "b h m d"], centres: Float[Array, "#b h c d"]) -> Int[Array, "b h m"]:
    """Index of the centre in the most similar direction, the first of equals."""
    centres = jnp.broadcast_to(unit(centres), (len(x), *centres.shape[1:]))
    return (x @ centres.swapaxes(2, 3)).argmax(-1).astype(jnp.int32)


def members(
    label: Int[Array, "b h m"], mask: Bool[Array, "b m"], count: int, dtype=jnp.float32
) -> Shaped[Array, "b h m c"]:  # fmt: skip
    """One-hot labels; zero rows at masked keys."""
    return jax.nn.one_hot(label, count, dtype=dtype) * mask[:, None, :, None]


def kmeans(
    x: Float[Array, "b h m d"], mask: Bool[Array, "b m"], count: int, iterations: int
) -> Float[Array, "b h c d"]:  # fmt: skip
    """Directions of ``count`` clusters of the valid keys.

    Deterministic: starts from the key farthest from the mean direction, then each time from the key farthest from all
    chosen ones, so that neither padding nor the order of keys matters. Clusters without members keep their direction.
    """
    points = unit(x) * mask[:, None, :, None]

    def pick(similarity: Array) -> Array:
        """The valid key of the least similarity [b h 1 d]."""
        index = jnp.where(mask[:, None], similarity, jnp.inf).argmin(-1)
        return jnp.take_along_axis(points, index[:, :, None, None], 2)

    def seed(i: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        centres, closest = state
        chosen = pick(closest)
        closest = jnp.maximum(closest, (points * chosen).sum(-1))
        return centres.at[:, :, i].set(chosen[:, :, 0]), closest

    def step(_: Array, centres: Array) -> Array:
        inside = members(nearest(points, centres), mask, count, points.dtype)
        sums = inside.swapaxes(2, 3) @ points
        return jnp.where(inside.sum(2)[..., None] > 0, unit(sums), centres)

    first = pick((points * unit(points.sum(2, keepdims=True))).sum(-1))
    centres = jnp.zeros((*points.shape[:2], count, points.shape[3]), points.dtype).at[:, :, :1].set(first)
    centres, _ = jax.lax.fori_loop(1, count, seed, (centres, (points * first).sum(-1)))
    return jax.lax.fori_loop(0, iterations, step, centres)
