"""One size of scenes for all tests of commands: compiling takes most of their time."""

from __future__ import annotations

import pytest

from tests.factories.few_programs import use_few_programs


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Scenes are sampled one by one, by the same programs whatever their number."""
    with pytest.MonkeyPatch.context() as patch:
        use_few_programs(patch)
        yield
