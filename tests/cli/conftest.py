"""Few sizes for all tests of commands: most of their time is compiling."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Scenes have one of two sizes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scjax.generate.batching.BUCKETS", ((16, 16), (61, 100)))
        yield
