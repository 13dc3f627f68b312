"""Scenes through the autoencoder and back."""

from __future__ import annotations

import dataclasses

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


def test_scenes_are_decoded_in_float32_whatever_the_network_was_trained_in():
    model = tiny_model()
    assert model.autoencoder.config.compute == "float32"
    config = dataclasses.replace(model.autoencoder.config, compute="bfloat16")
    rounded = model.with_component("autoencoder", config, model.autoencoder.params)
    scene = unpadded(example_scene(0, agents=3, lanes=4))
    ((exact,), (decoded,)) = (scjax.reconstruct(one, [scene]) for one in (model, rounded))
    np.testing.assert_array_equal(decoded.lanes, exact.lanes)
    np.testing.assert_array_equal(decoded.agents, exact.agents)


def test_reconstruct_refuses_a_model_without_autoencoder():
    with pytest.raises(ValueError, match="no autoencoder"):
        scjax.reconstruct(tiny_model().without("autoencoder"), [])
