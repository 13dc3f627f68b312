"""Ranges of the numbers that building and captioning take."""

from __future__ import annotations

import numbers
from typing import Any

MAX_COUNT = 1_000_000  # of logs, worlds, poses, steps, meters
MAX_SEED = 2**63 - 1  # of jax.random.key too
MAX_WORKERS = 256


def check_number(
    name: str, value: Any, low: int | float, high: int | float, advice: str = "", *, whole: bool = True
) -> None:
    """Raises a ValueError unless ``value`` is a number of ``low`` .. ``high``, both included.

    Args:
      advice: how the message ends; by default it names the range.
      whole: refuse fractions.

    Raises:
      ValueError: another type, NaN, or out of the range.
    """
    kind: Any = numbers.Integral if whole else numbers.Real
    if isinstance(value, kind) and not isinstance(value, bool) and low <= value <= high:  # NaN is in no range
        return
    noun = "whole number" if whole else "number"
    raise ValueError(f"{name} is {value}: {advice or f'give a {noun} from {low} to {high}'}")


def check_seed(seed: Any) -> None:
    """Raises a ValueError unless ``seed`` is a whole number of 63 bits."""
    check_number("seed", seed, 0, MAX_SEED, f"give a whole number from 0 to 2^63 - 1 ({MAX_SEED})")


def check_workers(workers: Any) -> None:
    """Raises a ValueError unless ``workers`` is a possible number of processes."""
    check_number("workers", workers, 0, MAX_WORKERS, f"give 0 or more processes, {MAX_WORKERS} at most")
