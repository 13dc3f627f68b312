"""Embeddings: shapes, a scene alone equals the scene among others, posterior means, and users' mistakes."""

import numpy as np
import pytest

from scjax.generate.embed import embed
from scjax.scene import unpadded
from tests.factories.examples import example_scene
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def model():
    return tiny_model()


def test_a_scene_alone_is_the_scene_among_others(model):
    scenes = [unpadded(example_scene(seed, agents=2 + seed, lanes=3 + seed)) for seed in range(3)]
    many = embed(model, scenes)
    for scene, found in zip(scenes, many, strict=True):
        (alone,) = embed(model, [scene])
        widths = (model.autoencoder.config.lane_latent, model.autoencoder.config.agent_latent)
        assert found.lanes.shape == (len(scene.lane_mask), widths[0])
        assert found.agents.shape == (len(scene.agent_mask), widths[1])
        assert found.lane_states.shape == (len(scene.lane_mask), model.autoencoder.config.lane_width)
        for one, two in zip(found, alone, strict=True):
            np.testing.assert_allclose(one, two, atol=1e-5)
    assert not np.allclose(many[0].lanes[0], many[1].lanes[0])


def test_a_model_without_autoencoder(model):
    with pytest.raises(ValueError, match="no autoencoder"):
        embed(model.without("autoencoder"), [])
    assert embed(model, []) == []
