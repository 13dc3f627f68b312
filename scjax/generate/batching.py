"""Scenes of different sizes in batches of few shapes, so that few programs are compiled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from scjax.scene.arguments import whole_number
from scjax.scene.limits import MAX_SLOTS

BUCKETS = ((8, 8), (16, 16), (16, 28), (32, 32), (61, 48), (61, 64), (61, 100))
"""(agent, lane) slots of padded scenes, in the order of their work; each is a set of programs to compile.

Of the denoiser's work on scenes of the shipped model's own counts, 64 % is on real tokens."""

GROUP = 4
"""Scenes in a call of a compiled program, when there is more than one; 8 would be a tenth faster for each scene."""

Bucket = tuple[int, int]


def padded_size(agents: int, lanes: int, least: Bucket = (0, 0)) -> Bucket:
    """The smallest bucket that holds so many agents and lanes, and ``least``.

    Raises:
      ValueError: they are more than the largest bucket holds.
    """
    agents, lanes = max(agents, least[0]), max(lanes, least[1])
    for bucket in BUCKETS:
        if agents <= bucket[0] and lanes <= bucket[1]:
            return bucket
    raise ValueError(f"{agents} agents and {lanes} lanes are more than the {BUCKETS[-1]} that a scene may have")


def least_size(value: Any) -> Bucket:
    """The option ``padded_size`` of ``scjax.sample`` as a bucket; (0, 0) for None.

    Raises:
      ValueError: it is no pair of whole numbers of at least 0.
    """
    if value is None:
        return (0, 0)
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ValueError(f"padded_size must be two whole numbers, (agents, lanes), not {value!r}")
    agents, lanes = (whole_number(n, "padded_size: each number", 0, MAX_SLOTS) for n in value)
    return agents, lanes


def in_batches(
    sizes: Sequence[tuple[int, int]], group: int = GROUP, least: Bucket = (0, 0)
) -> Iterator[tuple[Bucket, list[int], list[int]]]:
    """Splits scenes into batches of one bucket and ``group`` rows each.

    Scenes that do not fill a batch of their own bucket are put into the next larger one that is used. So one batch at
    most has rows without a scene, and a few scenes of several sizes share one program.

    Args:
      sizes: (agents, lanes) of every scene.
      least: slots that every bucket has.

    Yields:
      bucket; indices of the scenes in the batch; the same indices, filled up to ``group`` rows with the first one.
    """
    members: dict[Bucket, list[int]] = {}
    for index, size in enumerate(sizes):
        members.setdefault(padded_size(*size, least), []).append(index)
    used = sorted(members, key=BUCKETS.index)
    waiting: list[int] = []
    for bucket in used:
        indices = waiting + members[bucket]
        rest = len(indices) % group if bucket != used[-1] else 0
        full, waiting = indices[: len(indices) - rest], indices[len(indices) - rest :]
        for start in range(0, len(full), group):
            part = full[start : start + group]
            yield bucket, part, part + [part[0]] * (group - len(part))
