"""Checks of argument and return types in ``scjax``: those of jaxtyping with beartype, at less cost.

``jaxtyped`` binds the arguments of a call and checks them twice, whatever the annotations are, and makes two functions
of each that it decorates. Beartype alone states the same; where there are arrays, within one table of sizes. To check
an array takes 20 µs: arrays of the types, shapes and dtypes of an earlier call of a function pass at once. A function
inside of another is a new one at every call of that: its checks are made once and shared, since to make them takes a
thousand times as long as to run them.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import threading
import types
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
    annotations = _types(function)
    if inspect.isgeneratorfunction(function):
        return _checks_at_the_call(function, annotations, typechecker)
    function.__annotations__ = annotations
    if not any(map(_has_array, annotations.values())):
        return typechecker(function, conf=_AS_JAXTYPING)
    parameters = inspect.signature(function).parameters.values()
    arrays = [parameter for parameter in parameters if _has_array(annotations.get(parameter.name))]
    several = inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD
    if all(map(_is_known_by_shape, annotations.values())) and not any(one.kind in several for one in arrays):
        return _remembers_shapes(function, annotations, typechecker, [one.name for one in parameters], arrays)
    return _with_sizes(function, typechecker)


def _checks_at_the_call(function: Callable, annotations: dict[str, Any], typechecker: Callable) -> Callable:
    """A generator with checks of its arguments: beartype alone would check them at the first element."""

    @functools.wraps(function)
    def arguments_of(*arguments: Any, **named: Any) -> None: ...

    arguments_of.__annotations__ = {name: hint for name, hint in annotations.items() if name != "return"}
    check = _with_checks(arguments_of, typechecker)

    @functools.wraps(function)
    def checked(*arguments: Any, **named: Any) -> Any:
        check(*arguments, **named)
        return function(*arguments, **named)

    return checked


def _with_sizes(function: Callable, typechecker: Callable) -> Callable:
    checked = typechecker(function, conf=_AS_JAXTYPING)

    @functools.wraps(function)
    def with_sizes(*arguments: Any, **named: Any) -> Any:
        with _SIZES:
            return checked(*arguments, **named)

    return with_sizes


def _remembers_shapes(
    function: Callable, annotations: dict[str, Any], typechecker: Callable, names, arrays
) -> Callable:
    """As ``_with_sizes``, but arrays are checked at their first shapes only, and everything else at every call."""
    positions = [names.index(one.name) for one in arrays if one.kind is not inspect.Parameter.KEYWORD_ONLY]
    array_names, returns_arrays = [one.name for one in arrays], _has_array(annotations.get("return"))
    passed: dict[Any, set] = {}  # shapes of arguments -> those of the results that passed with them
    result = threading.local()

    @functools.cache
    def all_checked() -> Callable:
        """Made at the first call: to make checks takes a millisecond, and a process calls few of all functions."""
        return _with_sizes(function, typechecker)

    @functools.cache
    def without_arrays() -> Callable:
        copy = _copy(function)
        copy.__annotations__ = {name: hint for name, hint in annotations.items() if not _has_array(hint)}
        return typechecker(copy, conf=_AS_JAXTYPING)

    @functools.cache
    def check_result() -> Callable:
        @functools.wraps(function)
        def result_of(*arguments: Any, **named: Any) -> Any:
            return result.value

        return _with_sizes(result_of, typechecker)

    @functools.wraps(function)
    def remembers(*arguments: Any, **named: Any) -> Any:
        count = len(arguments)
        shapes = tuple([_shape(arguments[i]) if i < count else None for i in positions])
        if named:
            shapes += tuple([(name, _shape(named[name])) for name in array_names if name in named])
        results = passed.get(shapes)
        if results is None:
            value = all_checked()(*arguments, **named)
            if len(passed) < _MOST_SHAPES:
                passed[shapes] = {_shape(value)}
            return value
        value = without_arrays()(*arguments, **named)
        if returns_arrays and _shape(value) not in results:
            result.value = value
            check_result()(*arguments, **named)
            result.value = None
            results.add(_shape(value))
        return value

    return remembers


_MOST_SHAPES = 1000


def _shape(value: Any) -> Any:
    """What checks of array types look at."""
    if isinstance(value, tuple):
        return type(value), *map(_shape, value)
    shape = getattr(value, "shape", None)
    return type(value) if shape is None else (type(value), shape, getattr(value, "dtype", None))


def _copy(function: Callable) -> Callable:
    parts = function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    copy = types.FunctionType(*parts)
    copy.__kwdefaults__ = function.__kwdefaults__
    return functools.update_wrapper(copy, function, updated=("__dict__",))


def _types(function: Callable) -> dict[str, Any]:
    try:  # all at once, which is quicker
        types_of = typing.get_type_hints(function, include_extras=True)
    except Exception:
        return {name: _resolved(hint, function.__globals__) for name, hint in function.__annotations__.items()}
    return {name: types_of[name] for name in function.__annotations__}


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


def _is_known_by_shape(hint: Any) -> bool:
    """Whether the type has nothing to do with arrays, or types, shapes and dtypes decide if a value has it."""
    if not _has_array(hint):
        return True
    if _is_array_type(hint):
        return "{" not in hint.dim_str  # a size that is an argument's
    if typing.get_origin(hint) not in (typing.Union, types.UnionType, tuple):
        return False
    return all(
        _is_known_by_shape(one) if _has_array(one) else isinstance(one, type) or one is Ellipsis
        for one in typing.get_args(hint)
    )


def _is_array_type(hint: Any) -> bool:
    return type(hint).__module__.split(".")[0] == "jaxtyping"


def _has_array(hint: Any) -> bool:
    if _is_array_type(hint):
        return True
    return any(map(_has_array, hint if isinstance(hint, list | tuple) else typing.get_args(hint)))
