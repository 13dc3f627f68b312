"""Strict conversion of a flat state dict into a parameter tree: each array is used, known as unused, or an error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from scjax.nn.functional import Path, flatten, unflatten


class Transform(NamedTuple):
    """A change of memory layout and its inverse."""

    forward: Callable[[np.ndarray], np.ndarray]
    backward: Callable[[np.ndarray], np.ndarray]


SAME = Transform(lambda x: x, lambda x: x)
TRANSPOSE = Transform(lambda x: x.T, lambda x: x.T)  # Linear: [out, in] there, [in, out] here
DROP_FIRST = Transform(lambda x: x[0], lambda x: x[None])  # [1, n, d] there, [n, d] here

Rules = Mapping[str, tuple[Path, Transform]]


def convert(
    state: Mapping[str, np.ndarray],
    rules: Rules,
    expected: Any,
    ignored: Iterable[str] = (),
    aliases: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """The parameters that ``state`` holds, as the nested dict that ``Functional.init`` would give.

    Args:
      state: foreign key -> array.
      rules: foreign key -> (path in the parameter tree, layout change).
      expected: the parameter tree, or its abstract values (``jax.eval_shape(init, key)``).
      ignored: foreign keys that may be present and are never used.
      aliases: foreign key -> the key whose array it repeats; may be absent, must agree if present.

    Raises:
      ValueError: listing all unexpected, missing and misshapen entries and all aliases that disagree.
    """
    aliases, leaves = dict(aliases or {}), flatten(expected)
    uncovered = leaves.keys() - {path for path, _ in rules.values()}
    if uncovered:
        raise ValueError(f"no rule covers the parameters {_listed('/'.join(map(str, path)) for path in uncovered)}")

    problems, params = [], {}
    unexpected = state.keys() - rules.keys() - set(ignored) - aliases.keys()
    missing = rules.keys() - state.keys()
    if unexpected:
        problems.append(f"unexpected: {_listed(unexpected)}")
    if missing:
        problems.append(f"missing: {_listed(missing)}")
    for key in sorted(rules.keys() & state.keys()):
        path, transform = rules[key]
        if path not in leaves:
            problems.append(f"{key}: this network has no parameter {'/'.join(map(str, path))}")
            continue
        value = np.asarray(state[key])
        shape = transform.backward(np.broadcast_to(np.zeros((), value.dtype), leaves[path].shape)).shape
        if value.shape != shape:
            problems.append(f"misshapen: {key} is {value.shape}, this network needs {shape}")
        else:
            params[path] = jnp.asarray(transform.forward(value), leaves[path].dtype)
    for alias in sorted(aliases.keys() & state.keys()):
        if aliases[alias] in state and not np.array_equal(state[alias], state[aliases[alias]]):
            problems.append(f"{alias} should repeat {aliases[alias]}, but their values differ")
    if problems:
        raise ValueError(
            "the state dict does not fit this network (is it of another model, or of another configuration?):\n  "
            + "\n  ".join(problems)
        )
    return unflatten(params)


def export(params: Any, rules: Rules) -> dict[str, np.ndarray]:
    """The inverse of ``convert``: foreign key -> array, without ignored keys and aliases (also for gradients)."""
    leaves = flatten(params)
    return {key: transform.backward(np.asarray(leaves[path])) for key, (path, transform) in rules.items()}


def _listed(names: Iterable[str], limit: int = 20) -> str:
    names = sorted(names)
    return ", ".join(names[:limit]) + (f" and {len(names) - limit} more" if len(names) > limit else "")
