"""The one boundary between nnx definitions and pure functions: ``init(key) -> params``, ``apply(params, ...)``.

Modules are written in the tree-mode subset of nnx (no shared sub-modules, no mutation in the forward pass, no stored
Rngs); from here on parameters are nested dicts and every transform is JAX's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from flax import nnx

from scjax.nn.init import ParamInit

Params = dict[str, Any]
Path = tuple[str | int, ...]


class Functional(NamedTuple):
    """A network as two pure functions.

    Attributes:
      init: typed key -> parameters (nested dict of float32 arrays).
      apply: (params, *args, method="__call__", **kwargs) -> result of that method.
    """

    init: Callable[[jax.Array], Params]
    apply: Callable[..., Any]


def functional(make: Callable[[ParamInit], nnx.Module]) -> Functional:
    """Turns a module constructor into pure functions; the module is traced abstractly once."""
    counter = ParamInit()
    graphdef, abstract = nnx.split(nnx.eval_shape(lambda: make(counter)))

    def init(key: jax.Array) -> Params:
        # The open interval (-1, 1): the least float32 above -1 keeps the inverse error function finite.
        numbers = jax.random.uniform(key, (counter.used,), minval=np.nextafter(np.float32(-1), np.float32(0)))
        return nnx.to_pure_dict(nnx.state(make(ParamInit(numbers))))

    def apply(params: Params, *args, method: str = "__call__", **kwargs):
        state = jax.tree.map(lambda leaf: leaf, abstract)
        nnx.replace_by_pure_dict(state, params)
        return getattr(nnx.merge(graphdef, state), method)(*args, **kwargs)

    return Functional(jax.jit(init), apply)


def count(params: Params) -> int:
    """Number of scalars in a parameter tree (also an abstract one from ``jax.eval_shape``)."""
    return sum(leaf.size for leaf in jax.tree.leaves(params))


def flatten(tree: Any) -> dict[Path, Any]:
    """Nested dict -> {path: leaf}; positions in lists of modules are int keys."""
    return {tuple(entry.key for entry in path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(tree)}


def unflatten(leaves: Mapping[Path, Any]) -> Params:
    """Inverse of ``flatten``."""
    tree: dict[Any, Any] = {}
    for path, leaf in leaves.items():
        node = tree
        for name in path[:-1]:
            node = node.setdefault(name, {})
        node[path[-1]] = leaf
    return tree
