"""Few sizes for all tests of sampling: most of their time is compiling."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="module", autouse=True)
def few_programs(request):
    """Scenes have one of two sizes, but where sizes are what is tested."""
    with pytest.MonkeyPatch.context() as patch:
        if not request.path.stem.startswith("test_batching"):
            patch.setattr("scjax.generate.batching.BUCKETS", ((16, 16), (61, 100)))
        yield
