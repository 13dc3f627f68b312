"""Pickles from outside, read without running any of their code: NumPy arrays and plain containers only.

A pickle is a program that may call any function. Here it can name a few types and functions, none of
which does more than hold data, and its structure is bounded before it is read.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
from collections.abc import Callable
from typing import Any

import numpy as np

MAX_OPERATIONS = 20_000_000
MAX_NESTING = 64
_CURE = "give a file that holds plain data, such as those of ScenarioNet"


def load_plain_pickle(data: bytes) -> Any:
    """The value in a pickle of dicts, lists, tuples, sets, texts, numbers and NumPy arrays of numbers.

    Raises:
      ValueError: it is damaged, names anything else, or is nested more than 64 deep; nothing of it is executed.
    """
    check_nesting(data)
    try:
        return _PlainUnpickler(io.BytesIO(data)).load()
    except ValueError:
        raise
    except Exception as error:  # damaged pickles raise nearly every kind
        raise ValueError(f"no readable pickle ({type(error).__name__}: {error}): copy or download it again") from error


class _NumberType:
    """Stands for a NumPy dtype, whose own state a pickle could damage for the whole process."""

    def __init__(self, name: Any = None, *_: Any):
        if not isinstance(name, str) or not re.fullmatch(r"[biufSU]\d{1,9}", name):
            raise ValueError(f"it names the number type {str(name)[:40]!r}: {_CURE}")
        self.dtype = np.dtype(name)

    def __setstate__(self, state: Any) -> None:
        order, nested = state[1], state[2:5]
        if order not in ("<", ">", "=", "|") or nested != (None, None, None):
            raise ValueError(f"it holds a number type of several parts: {_CURE}")
        self.dtype = self.dtype.newbyteorder(order)


class _PlainArray(np.ndarray):
    """An array that takes its content from the pickle, once the sizes fit."""

    def __setstate__(self, state: Any) -> None:
        _, shape, number_type, is_fortran, raw = state
        content: Any = (1, *_checked(raw, number_type, shape), is_fortran is True, raw)
        super().__setstate__(content)


def _empty_array(subtype: Any, shape: Any, _: Any) -> np.ndarray:
    """What is filled next with shape, type and bytes; a shape given here could take any amount of memory."""
    if subtype is not np.ndarray or shape != (0,):
        raise ValueError(f"it makes an array of the shape {str(shape)[:40]} without data: {_CURE}")
    return np.ndarray.__new__(_PlainArray, (0,), np.int8)


def _plain_buffer(buffer: Any, number_type: Any, shape: Any, order: Any) -> np.ndarray:
    shape, dtype = _checked(buffer, number_type, shape)
    return np.frombuffer(buffer, dtype).reshape(shape, order="F" if order == "F" else "C")


def _plain_scalar(number_type: Any, raw: Any) -> Any:
    return np.frombuffer(raw, _checked(raw, number_type, ())[1])[0]


def _checked(raw: Any, number_type: Any, shape: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array, if its bytes have just that size."""
    if (
        not isinstance(number_type, _NumberType)
        or not isinstance(raw, bytes | bytearray)
        or not isinstance(shape, tuple)
    ):
        raise ValueError(f"it holds an array of something else than numbers: {_CURE}")
    size = number_type.dtype.itemsize
    if not all(type(edge) is int and edge >= 0 for edge in shape) or math.prod(shape) * size != len(raw) or not size:
        raise ValueError(f"an array of the shape {str(shape)[:40]} has other bytes than that: {_CURE}")
    return shape, number_type.dtype


def _plain_bytes(text: Any, encoding: Any) -> bytes:
    """Bytes as pickles of protocol 2 hold them."""
    if not isinstance(text, str) or encoding != "latin1":
        raise ValueError(f"it encodes a text as {str(encoding)[:40]!r}: {_CURE}")
    return text.encode("latin1")


def _plain_dict(*_: Any) -> dict[Any, Any]:
    """Stands for defaultdict and OrderedDict; their items follow."""
    return {}


class _Function:
    """A function that a pickle may call, and not change."""

    __slots__ = ("_function",)

    def __init__(self, function: Callable[..., Any]):
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        return self._function(*arguments)

    def __setstate__(self, _: Any) -> None:
        raise ValueError(f"it changes a function: {_CURE}")


_NUMPY = {
    ("multiarray", "_reconstruct"): _Function(_empty_array),
    ("multiarray", "scalar"): _Function(_plain_scalar),
    ("numeric", "_frombuffer"): _Function(_plain_buffer),
}
_ALLOWED: dict[tuple[str, str], Callable[..., Any] | type] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): _NumberType,
    ("_codecs", "encode"): _Function(_plain_bytes),
    ("collections", "defaultdict"): _Function(_plain_dict),
    ("collections", "OrderedDict"): _Function(_plain_dict),
    **{(f"numpy.{core}.{module}", name): item for core in ("core", "_core") for (module, name), item in _NUMPY.items()},
    **{
        (module, name): kind
        for module in ("builtins", "__builtin__")
        for name, kind in (("set", set), ("frozenset", frozenset))
    },
    **{("builtins", kind.__name__): kind for kind in (int, float, bool, str, list, dict, tuple)},
}
"""Module and name of a pickle -> what stands for it. The types of numbers are factories of defaultdict."""


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        item = _ALLOWED.get((module, name))
        if item is None:
            raise ValueError(f"it names {module[:60]}.{name[:60]}, which could run code: {_CURE}")
        return item

    def persistent_load(self, pid: Any) -> Any:
        raise ValueError(f"it refers to an object outside of it: {_CURE}")


def check_nesting(data: bytes) -> None:
    """Follows how deeply the values of a pickle are nested, without making them.

    Raises:
      ValueError: they are nested more than ``MAX_NESTING`` deep, the pickle is too long, or it is damaged.
    """
    stack: list[int | None] = []  # depth of each value; None is a mark
    memo: dict[int, int] = {}
    try:
        for count, (operation, argument, _) in enumerate(pickletools.genops(data)):
            index: Any = argument
            if count > MAX_OPERATIONS:
                raise ValueError(f"it has more than {MAX_OPERATIONS} operations: split the file")
            name = operation.name
            if name in ("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"):
                memo[len(memo) if index is None else int(index)] = stack[-1] or 0
                continue
            if name in ("GET", "BINGET", "LONG_BINGET"):
                stack.append(memo[int(index)])
                continue
            depth = _pop(stack, operation)
            for item in operation.stack_after:
                stack.append(None if item is pickletools.markobject else depth)
            if depth > MAX_NESTING:
                raise ValueError(f"its values are nested more than {MAX_NESTING} deep: {_CURE}")
    except (IndexError, KeyError, TypeError) as error:
        raise ValueError(f"no readable pickle ({type(error).__name__}): copy or download it again") from error
    except ValueError as error:
        if _CURE in str(error) or "split the file" in str(error):
            raise
        raise ValueError(f"no readable pickle ({error}): copy or download it again") from error


def _pop(stack: list[int | None], operation: pickletools.OpcodeInfo) -> int:
    """Removes what an operation takes, and gives the depth of what it leaves."""
    before = operation.stack_before
    taken: list[int] = []
    if pickletools.stackslice in before or pickletools.markobject in before:
        while (depth := stack.pop()) is not None:
            taken.append(depth)
        before = before[: before.index(pickletools.markobject)]
    for _ in before:
        taken.append(stack.pop() or 0)
    return 1 + max(taken) if taken else 0
