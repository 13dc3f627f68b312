"""Functions of lane pairs in blocks of destination rows: blocks fit the cache, and padding costs nothing.

On a CPU the features of 10,000 pairs do not stay in the cache between two operations, and half of a batch's pairs are
padding. For larger batches ``blockwise_map`` therefore loops over scenes and blocks of rows, skips blocks without a
real row, and recomputes each block for the gradient instead of storing intermediate values.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from scjax.nn.cpu.backend import on_cpu

# Lane pairs per block: 64 float32 features of each are 128 kB, so a dozen such arrays fit a core's L2 cache, and blocks
# of few rows have little padding. In much smaller blocks the overhead of starting them dominates.
_BLOCK_PAIRS = 512

_SMALL = 2**12
"""Pairs of a batch that are few enough to be computed at once: loops over them would only take longer to compile."""


def blockwise_map(
    function: Callable[[Any, Any], Any], scenes: Any, rows: Any, real: Bool[Array, "b l"], sources: int
) -> Any:
    """``function(scenes, rows)``, in blocks on a CPU, at once elsewhere. The backward pass recomputes it.

    Args:
      function: (PyTree [b, ...], PyTree [b, r, ...]) -> PyTree [b, r, ...], row by row; may close over parameters.
      scenes: inputs shared by all rows of a scene, [B, ...].
      rows: inputs per row, [B, L, ...].
      real: rows to compute; others may be zero in the result.
      sources: pairs per row.
    """
    if not on_cpu() or real.size * sources <= _SMALL:
        return jax.checkpoint(function)(scenes, rows)
    length = real.shape[1]
    blocks = math.ceil(length / max(1, _BLOCK_PAIRS // max(sources, 1)))
    size = math.ceil(length / blocks)

    def block(x: Array) -> Array:
        x = jnp.pad(x, ((0, 0), (0, blocks * size - length), *((0, 0),) * (x.ndim - 2)))
        return x.reshape(x.shape[0], blocks, 1, size, *x.shape[2:])

    scenes = jax.tree.map(lambda x: x[:, None], scenes)
    out = _walk(function, scenes, jax.tree.map(block, rows), block(real).any((2, 3)))
    return jax.tree.map(lambda x: x.reshape(x.shape[0], blocks * size, *x.shape[4:])[:, :length], out)


def _walk(function: Callable[[Any, Any], Any], scenes: Any, rows: Any, active: Bool[Array, "b n"]) -> Any:
    """``function`` on each scene [B, 1, ...] and block [B, n, 1, r, ...]; zeros where not ``active``."""
    first = jax.tree.map(lambda x: x[0], scenes), jax.tree.map(lambda x: x[0, 0], rows)
    function, consts = jax.closure_convert(function, *first)
    shapes = jax.eval_shape(function, *first, *consts)
    scene_floats, scene_rest = _split(scenes)
    row_floats, row_rest = _split(rows)

    def nothing():
        return jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)

    @jax.custom_vjp
    def run(consts, scene_floats, row_floats, scene_rest, row_rest, active):
        def scene_step(_, x):
            scene_floats, scene_rest, *blocks = x
            scene = _join(scene_floats, scene_rest)

            def row_step(_, y):
                row_floats, row_rest, active = y
                row = _join(row_floats, row_rest)
                return None, jax.lax.cond(active, lambda: function(scene, row, *consts), nothing)

            return None, jax.lax.scan(row_step, None, tuple(blocks))[1]

        return jax.lax.scan(scene_step, None, (scene_floats, scene_rest, row_floats, row_rest, active))[1]

    def forward(*args):
        return run(*args), args

    def backward(args, gradient):
        consts, scene_floats, row_floats, scene_rest, row_rest, active = args

        def scene_step(d_consts, x):
            scene_floats, scene_rest, *blocks = x

            def row_step(totals, y):
                row_floats, row_rest, active, gradient = y

                def work():
                    def of_floats(consts, scene_floats, row_floats):
                        return function(_join(scene_floats, scene_rest), _join(row_floats, row_rest), *consts)

                    *shared, d_row = jax.vjp(of_floats, consts, scene_floats, row_floats)[1](gradient)
                    return jax.tree.map(jnp.add, totals, tuple(shared)), d_row

                return jax.lax.cond(active, work, lambda: (totals, _zeros(row_floats)))

            (d_consts, d_scene), d_rows = jax.lax.scan(row_step, (d_consts, _zeros(scene_floats)), tuple(blocks))
            return d_consts, (d_scene, d_rows)

        xs = (scene_floats, scene_rest, row_floats, row_rest, active, gradient)
        d_consts, (d_scenes, d_rows) = jax.lax.scan(scene_step, _zeros(consts), xs)
        return d_consts, d_scenes, d_rows, None, None, None

    run.defvjp(forward, backward)
    return run(consts, scene_floats, row_floats, scene_rest, row_rest, active)


def _zeros(tree: Any) -> Any:
    return jax.tree.map(jnp.zeros_like, tree)


def _split(tree: Any) -> tuple[Any, Any]:
    """The floating-point leaves and the others, with None in the gaps."""

    def keep(active: bool) -> Any:
        return jax.tree.map(lambda x: x if jnp.issubdtype(x.dtype, jnp.floating) is active else None, tree)

    return keep(True), keep(False)


def _join(floats: Any, rest: Any) -> Any:
    return jax.tree.map(lambda x, y: y if x is None else x, floats, rest, is_leaf=lambda x: x is None)
