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


def rows_from(
    rows: Float[np.ndarray, "n d"], start: int, weights: tuple[Float[np.ndarray, " d"], float] | None = None
) -> Float[np.ndarray, "n d"]:
    return rows[start:]


def adder(start, make):
    """A function inside of another, with checks: a new one at every call."""

    @make
    def add(number: int, *, times: int = 1) -> int:
        return start + times * number

    return add


def scaler(weights, make):
    @make
    def scale(rows: Float[np.ndarray, "n d"], by: Float[np.ndarray, " d"] = weights) -> Float[np.ndarray, "n d"]:
        return rows * by if len(rows) < 3 else rows[:1]

    return scale


@pytest.mark.parametrize("decorator", [jaxtyped, quick_jaxtyped])
@pytest.mark.parametrize(("target", "arguments", "is_refused"), CASES)
def test_quick_jaxtyped_refuses_the_same(decorator, target, arguments, is_refused):
    checked = decorator(typechecker=beartype.beartype)(undecorated(target))
    assert refuses(checked, *arguments) == is_refused


@pytest.mark.parametrize("decorator", [jaxtyped, quick_jaxtyped])
def test_functions_of_one_def_share_checks_and_no_values(decorator):
    make = decorator(typechecker=beartype.beartype)
    first, second = adder(1, make), adder(10, make)
    assert (first(2), second(2), second(2, times=3), first(number=2)) == (3, 12, 16, 3)
    assert refuses(second, "2") and refuses(first, 2, times="3") and refuses(adder(0.5, make), 2)
    one, two = scaler(TWO, make), scaler(2 * TWO, make)
    assert one(np.ones((1, 2))).sum() == 2 and two(np.ones((1, 2))).sum() == 4
    assert refuses(one, np.ones((1, 3)), TWO) and refuses(two, np.ones((3, 2)))  # it returns one row of three


@pytest.mark.parametrize("decorator", [jaxtyped, quick_jaxtyped])
@pytest.mark.parametrize(
    ("arguments", "is_refused"),
    [
        ((0,), False),
        ((0, (TWO, 1.5)), False),
        ((1,), True),  # it returns one row less
        (("0",), True),
        ((0, (TWO, "1.5")), True),
        ((0, (ONE, 1.5)), True),
        ((0, (TWO.astype(int), 1.5)), True),
        ((0, [TWO, 1.5]), True),
    ],
)
def test_calls_with_shapes_of_before_are_checked(decorator, arguments, is_refused):
    checked = decorator(typechecker=beartype.beartype)(rows_from)
    for _ in range(2):
        checked(np.ones((3, 2)), 0)
        checked(np.ones((3, 2)), 0, weights=(TWO, 0.5))
    assert refuses(checked, np.ones((3, 2)), *arguments) == is_refused
    assert refuses(checked, rows=np.ones((3, 2)), start=arguments[0], weights=(*arguments, None)[1]) == is_refused
    assert refuses(checked, np.ones((3, 2), int), 0) and refuses(checked, np.ones(3), 0)


def test_a_function_in_a_function_may_call_others_of_its_def():
    make = quick_jaxtyped(typechecker=beartype.beartype)

    def counter(other):
        @make
        def count_down(number: int) -> int:
            return number if other is None else 1 + other(number)

        return count_down

    assert counter(counter(counter(None)))(3) == 5
    assert refuses(counter(counter(None)), 3.5)


def test_the_package_is_checked():
    from scjax.generate.batching import padded_size

    assert refuses(padded_size, "3", 4) and not refuses(padded_size, 3, 4)
