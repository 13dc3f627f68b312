"""Most of the time of these tests is compiling: all that they sample has one shape,
large enough for any count that an untrained count predictor draws."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def one_bucket(monkeypatch):
    monkeypatch.setattr("scjax.generate.batching.BUCKETS", ((61, 100),))
