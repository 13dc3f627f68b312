"""Few sizes for all tests of maps: compiling takes time and memory."""

from __future__ import annotations

import pytest

from tests.factories.few_programs import use_few_programs


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Windows have one size, sampled with the model's own number of steps: these programs are those of the docs."""
    with pytest.MonkeyPatch.context() as patch:
        use_few_programs(patch)
        yield
