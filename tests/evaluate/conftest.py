"""Worlds and a model that tests of one module share."""

from __future__ import annotations

import pytest

from tests.factories.evaluations import RoadModel, save_worlds


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    return save_worlds(tmp_path_factory.mktemp("evaluate") / "worlds")


@pytest.fixture
def road_model():
    return RoadModel()
