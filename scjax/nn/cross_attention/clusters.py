"""Spherical k-means of attention keys, by scene and head (Dhillon & Modha 2001; attention-variants §4.6, §4.9)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped


def unit(x: Float[Array, "*b d"]) -> Float[Array, "*b d"]:
    """x / |x|; the zero vector stays, with a finite gradient."""
    return x * jax.lax.rsqrt(jnp.square(x).sum(-1, keepdims=True) + 1e-12)


def nearest(x: Float[Array, "b h m d"], centers: Float[Array, "#b h c d"]) -> Int[Array, "b h m"]:
    """Index of the center in the most similar direction, the first of equals."""
    centers = jnp.broadcast_to(unit(centers), (len(x), *centers.shape[1:]))
    return (x @ centers.swapaxes(2, 3)).argmax(-1).astype(jnp.int32)


def members(
    label: Int[Array, "b h m"], mask: Bool[Array, "b m"], count: int, dtype=jnp.float32
) -> Shaped[Array, "b h m c"]:
    """One-hot labels; zero rows at masked keys."""
    return jax.nn.one_hot(label, count, dtype=dtype) * mask[:, None, :, None]


def kmeans(
    x: Float[Array, "b h m d"], mask: Bool[Array, "b m"], count: int, iterations: int
) -> Float[Array, "b h c d"]:
    """Directions of ``count`` clusters of the valid keys.

    Deterministic: the first center is the key farthest from the mean direction, each further one the key farthest from
    all earlier ones, so neither padding nor the order of keys matters. Empty clusters keep their direction.
    """
    points = unit(x) * mask[:, None, :, None]

    def pick(similarity: Array) -> Array:
        """The valid key of the least similarity [b h 1 d]."""
        index = jnp.where(mask[:, None], similarity, jnp.inf).argmin(-1)
        return jnp.take_along_axis(points, index[:, :, None, None], 2)

    def seed(i: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        centers, closest = state
        point = pick(closest)
        closest = jnp.maximum(closest, (points * point).sum(-1))
        return centers.at[:, :, i].set(point[:, :, 0]), closest

    def step(_: Array, centers: Array) -> Array:
        inside = members(nearest(points, centers), mask, count, points.dtype)
        sums = inside.swapaxes(2, 3) @ points
        return jnp.where(inside.sum(2)[..., None] > 0, unit(sums), centers)

    first = pick((points * unit(points.sum(2, keepdims=True))).sum(-1))
    centers = jnp.zeros((*points.shape[:2], count, points.shape[3]), points.dtype).at[:, :, :1].set(first)
    centers, _ = jax.lax.fori_loop(1, count, seed, (centers, (points * first).sum(-1)))
    return jax.lax.fori_loop(0, iterations, step, centers)
