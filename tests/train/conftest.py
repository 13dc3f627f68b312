"""Most of the time of these tests is compiling: all that they sample has one shape,
large enough for any count that an untrained count predictor draws."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True, scope="module")
def one_bucket():
    """For a whole module: its trainings, which draw pictures, are fixtures of that scope."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scjax.generate.batching.BUCKETS", ((61, 100),))
        yield
