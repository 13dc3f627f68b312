"""One size of scenes for tests that sample with the model that ships: compiling is what takes their time."""

from __future__ import annotations

import pytest

BUCKETS = ((24, 40), (61, 100))
"""(agent, lane) slots; what these tests sample fits the first, so that they share programs, also between files."""


def use_few_programs(patch: pytest.MonkeyPatch) -> None:
    """Scenes have one shape if they fit it, and are sampled one by one."""
    patch.setattr("scjax.generate.batching.BUCKETS", BUCKETS)
    patch.setattr("scjax.generate.sample.GROUP", 1)
