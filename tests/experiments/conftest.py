"""All that these tests sample has one shape: most of their time is compiling."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True, scope="module")
def one_bucket():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scjax.generate.batching.BUCKETS", ((61, 100),))
        yield
