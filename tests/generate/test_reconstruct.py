"""Scenes through the autoencoder and back."""

from __future__ import annotations

import numpy as np
import pytest

import scjax
from scjax.scene import Link, unpadded
from tests.factories.examples import example_scene
from tests.factories.worlds import tiny_model


def test_reconstruct_keeps_count_and_order():
    scenes = [unpadded(example_scene(seed, agents=3 + seed, lanes=4 + seed)) for seed in range(3)]
    for scene, decoded in zip(scenes, scjax.reconstruct(tiny_model(), scenes), strict=True):
        assert decoded.agents.shape == scene.agents.shape and decoded.lanes.shape == scene.lanes.shape
        assert (np.diag(decoded.links) == Link.SELF).all()


def test_reconstruct_refuses_a_model_without_autoencoder():
    with pytest.raises(ValueError, match="no autoencoder"):
        scjax.reconstruct(tiny_model().without("autoencoder"), [])
