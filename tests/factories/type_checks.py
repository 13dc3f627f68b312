"""Checks of argument and return types in ``scjax``: those of jaxtyping with beartype, at less cost.

``jaxtyped`` binds the arguments of a call and checks them twice, whatever the annotations are, and makes two functions
of each that it decorates. Beartype alone states the same; where there are arrays, within one table of sizes. A function
inside of another is a new one at every call of that: its checks are made once and shared, since to make them takes a
thousand times as long as to run them.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import threading
import typing
from collections.abc import Callable
from typing import Any

from beartype import BeartypeConf
from jaxtyping import TypeCheckError, jaxtyped

_SIZES = jaxtyped("context")  # a table of the sizes that names in annotations have, for each call
_AS_JAXTYPING = BeartypeConf(violation_type=TypeCheckError)  # a TypeError, which code may answer


def quick_jaxtyped(*, typechecker: Callable) -> Callable:
    """What ``jaxtyping.jaxtyped`` does: a decorator of functions and dataclasses."""

    def decorate(target):
        if not inspect.isclass(target):
            return _checked(target, typechecker)
        if dataclasses.is_dataclass(target) and "__init__" in vars(target):
            target.__init__ = _checked(target.__init__, typechecker)
        return target

    return decorate


def _checked(function: Callable, typechecker: Callable) -> Callable:
    if hasattr(function, "__wrapped__") or not function.__annotations__:
        return function
    if "<locals>" not in function.__qualname__:
        return _with_checks(function, typechecker)
    key = function.__code__, function.__module__, repr(function.__annotations__), typechecker
    if key not in _SHARED_CHECKS:
        _SHARED_CHECKS[key] = _SharedChecks(function, typechecker)
    return _SHARED_CHECKS[key].of(function)


def _with_checks(function: Callable, typechecker: Callable) -> Callable:
    types = _types(function)
    if inspect.isgeneratorfunction(function):
        return jaxtyped(function, typechecker=typechecker)  # beartype alone would check at the first element
    function.__annotations__ = types
    checked = typechecker(function, conf=_AS_JAXTYPING)
    if not any(map(_has_array, types.values())):
        return checked

    @functools.wraps(function)
    def with_sizes(*arguments: Any, **named: Any) -> Any:
        with _SIZES:
            return checked(*arguments, **named)

    return with_sizes


def _types(function: Callable) -> dict[str, Any]:
    return {name: _resolved(hint, function.__globals__) for name, hint in function.__annotations__.items()}


class _SharedChecks:
    """The checks of all functions of one ``def`` inside of a function."""

    def __init__(self, function: Callable, typechecker: Callable):
        self._called = threading.local()  # the functions that are called, the innermost last
        function.__annotations__ = _types(function)

        @functools.wraps(function)
        def call(*arguments: Any, **named: Any) -> Any:
            return self._called.functions[-1](*arguments, **named)

        self._checked_call = _with_checks(call, typechecker)

    def of(self, function: Callable) -> Callable:
        """``function`` with the checks."""

        @functools.wraps(function)
        def checked(*arguments: Any, **named: Any) -> Any:
            functions = self._called.__dict__.setdefault("functions", [])
            functions.append(function)
            try:
                return self._checked_call(*arguments, **named)
            finally:
                functions.pop()

        return checked


_SHARED_CHECKS: dict[Any, _SharedChecks] = {}


def _resolved(hint: Any, names: dict[str, Any]) -> Any:
    """The type that an annotation names; ``Any`` for one that only the type checker can resolve, as jaxtyping does."""
    holder = type("Holder", (), {"__annotations__": {"value": hint}})
    try:
        return typing.get_type_hints(holder, names, include_extras=True)["value"]
    except Exception:
        return Any


def _has_array(hint: Any) -> bool:
    if type(hint).__module__.split(".")[0] == "jaxtyping":
        return True
    return any(map(_has_array, hint if isinstance(hint, list | tuple) else typing.get_args(hint)))
