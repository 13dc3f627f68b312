"""Few sizes for all tests of maps: compiling takes time and memory."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Windows have one of two sizes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scjax.generate.batching.BUCKETS", ((16, 28), (61, 100)))
        yield
