"""The quicker checks of types refuse what those of jaxtyping refuse."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import beartype
import numpy as np
import pytest
from jaxtyping import Float, TypeCheckError

from tests.factories.type_checks import jaxtyped, quick_jaxtyped


def refuses(function, *arguments, **named) -> bool:
    try:
        function(*arguments, **named)
    except TypeCheckError:
        return True
    return False


def repeat(text: str, times: int = 2) -> str | None:
    return None if times < 0 else text * times if times else 0  # pyright: ignore


def total(rows: Sequence[Float[np.ndarray, " n"]], weights: Float[np.ndarray, " n"]) -> Float[np.ndarray, ""]:
    return np.asarray(sum(row @ weights for row in rows))


def count(limit: int) -> Iterator[int]:
    yield from range(limit)


def untold(value: Nowhere) -> int:  # noqa: F821 # pyright: ignore
    return value


class Method:
    def double(self, number: int) -> int:
        return 2 * number


class Pair:
    first: int
    second: Float[np.ndarray, " n"] | None


class Named:
    name: str


ONE, TWO = np.ones(1), np.ones(2)
CASES = [
    (repeat, ("a",), False),
    (repeat, ("a", -1), False),
    (repeat, ("a", "b"), True),
    (repeat, (1,), True),
    (repeat, ("a", 0), True),  # it returns no text
    (total, ([TWO, TWO], TWO), False),
    (total, ([TWO], ONE), True),
    (total, ([2], TWO), True),
    (count, (3,), False),
    (count, ("3",), True),
    (untold, (3,), False),
    (untold, ("3",), True),
    (Method.double, (Method(), 3), False),
    (Method.double, (Method(), 3.5), True),
    (Pair, (1, TWO), False),
    (Pair, (1.5, TWO), True),
    (Pair, (1, np.ones((2, 2))), True),
    (Named, ("a",), False),
    (Named, (1,), True),
]


def undecorated(target):
    """``target``, or a new dataclass of its fields, since decorators change a class in place."""
    if not isinstance(target, type):
        return target
    names = {"__module__": target.__module__, "__annotations__": target.__annotations__}
    return dataclasses.dataclass(frozen=True)(type(target.__name__, (), names))


@pytest.mark.parametrize("decorator", [jaxtyped, quick_jaxtyped])
@pytest.mark.parametrize(("target", "arguments", "is_refused"), CASES)
def test_quick_jaxtyped_refuses_the_same(decorator, target, arguments, is_refused):
    checked = decorator(typechecker=beartype.beartype)(undecorated(target))
    assert refuses(checked, *arguments) == is_refused


def test_the_package_is_checked():
    from scjax.generate.batching import padded_size

    assert refuses(padded_size, "3", 4) and not refuses(padded_size, 3, 4)
