"""Most of the time of these tests is compiling: all that they sample has one shape."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def one_bucket(monkeypatch):
    monkeypatch.setattr("scjax.generate.sample.BUCKETS", ((52, 64),))


@pytest.fixture(autouse=True, scope="session")
def short_fits():
    """What reads points off latents is fitted in a hundredth of its steps, but where that is what is tested."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scjax.train.fit_position_head._STEPS", 40)
        patch.setattr("scjax.train.fit_position_head._BATCHES", 4)
        yield
