"""The one boundary between nnx definitions and pure functions: ``init(key) -> params``, ``apply(params, ...)``.

Modules are written in the tree-mode subset of nnx (no shared sub-modules, no mutation in the forward pass, no stored
Rngs); from here on parameters are nested dicts and every transform is JAX's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
from flax import nnx

from scjax.nn.init import ParamInit, path_numbers

Params = dict[str, Any]
Path = tuple[str | int, ...]


class Functional(NamedTuple):
    """A network as two pure functions.

    Attributes:
      init: typed key -> parameters (nested dict of float32 arrays).
      apply: (params, *args, method="__call__", **kwargs) -> result of that method.
      shapes: () -> the parameters as ``jax.ShapeDtypeStruct``; allocates nothing, however large the network is.
    """

    init: Callable[[jax.Array], Params]
    apply: Callable[..., Any]
    shapes: Callable[[], Params]


def functional(make: Callable[[ParamInit], nnx.Module]) -> Functional:
    """Turns a module constructor into pure functions; the module is traced abstractly once."""
    paths: list[str] = []
    sizes: list[int] = []

    def build() -> nnx.Module:
        module, recorder = _record(make)
        for path, size in recorder:
            paths.append(path)
            sizes.append(size)
        return module

    graphdef, abstract = nnx.split(nnx.eval_shape(build))

    def init(key: jax.Array) -> Params:
        return nnx.to_pure_dict(nnx.state(make(ParamInit(path_numbers(key, paths, sizes)))))

    def apply(params: Params, *args, method: str = "__call__", **kwargs):
        state = jax.tree.map(lambda leaf: leaf, abstract)
        nnx.replace_by_pure_dict(state, params)
        return getattr(nnx.merge(graphdef, state), method)(*args, **kwargs)

    def shapes() -> Params:
        leaves = flatten(nnx.to_pure_dict(abstract))
        return unflatten({path: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for path, leaf in leaves.items()})

    return Functional(jax.jit(init), apply, shapes)


def _record(make: Callable[[ParamInit], nnx.Module]) -> tuple[nnx.Module, list[tuple[str, int]]]:
    """The module, and path and size of each array that ``ParamInit`` gave it.

    An array that no parameter holds as it is has its number for a path.
    """
    param_init = ParamInit()
    module = make(param_init)
    paths = {id(leaf): path for path, leaf in flatten(nnx.to_pure_dict(nnx.state(module))).items()}
    requests = []
    for number, array in enumerate(param_init.requests):
        path = paths.get(id(array), ("unused", number))
        requests.append(("/".join(map(str, path)), math.prod(array.shape)))
    return module, requests


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
