"""A denoiser on what stands in for images, end to end: trained, sampled with an image and without."""

from __future__ import annotations

import chex
import jax
import numpy as np
import pytest

import scjax
from scjax.camera.raycast import CLASSES, GRID, render
from scjax.data.loader import LoaderConfig, training_batches, validation_scenes
from scjax.data.window_images import RaycastImages
from scjax.generate.conditions import Condition, Stream
from scjax.models.codec import scjax as ours
from scjax.models.denoiser.config import ImageCondition
from scjax.scene import Crop, unpadded, validate
from scjax.train.loop import train
from scjax.train.objectives import make_objective
from tests.factories.small_runs import get_config
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory, world_records):
    """A folder with records and an autoencoder."""
    folder = tmp_path_factory.mktemp("image")
    (folder / "records").symlink_to(world_records)
    scjax.save(tiny_model().without("denoiser"), folder / "autoencoder")
    return folder


def configured(folder, crops=(1.0, 0.0, 1.0)):
    config = get_config("denoiser")
    config.records, config.autoencoder = str(folder / "records"), str(folder / "autoencoder")
    config.condition, config.batch.crops = "image", crops
    config.optimizer.schedule = "constant"  # a linear one ends after its warm-up
    config.steps, config.checkpoint_every, config.picture_every, config.evaluate_every = 2, 2, 2, 2
    return config


def test_batches_carry_images_of_their_jittered_windows(folder):
    config = LoaderConfig(batch_size=4, buckets=((61, 100),), seed=5)
    batches = training_batches(folder / "records", ours(), config, images=RaycastImages())
    present = 0
    for _ in range(4):
        batch = next(batches)
        for row in range(4):
            present += bool(batch.has_image[row])
            assert batch.has_image[row] == (batch.scene.crop[row] == Crop.FORWARD)
            if batch.has_image[row]:
                expected = render(unpadded(batch.scene[row]))
                chex.assert_trees_all_equal((batch.image[row], batch.depth[row]), tuple(expected))
            else:
                assert not batch.image[row].any() and not batch.depth[row].any()
    assert 0 < present < 16
    state = batches.state()
    following = next(batches)
    again = training_batches(folder / "records", ours(), config, images=RaycastImages())
    again.restore(state)
    resumed = next(again)
    chex.assert_trees_all_equal((resumed.image, resumed.depth), (following.image, following.depth))


@pytest.fixture(scope="module")
def trained(folder):
    train(configured(folder), folder / "two")
    return scjax.load(folder / "two" / "model")


def test_train_on_images_draws_samples(folder, trained):
    assert list((folder / "two" / "pictures").glob("*.png"))


def test_image_model_samples_with_an_image(folder, trained):
    assert trained.denoiser.config.condition == ImageCondition(len(CLASSES), GRID, patch=1)
    assert trained.notes["images"] == "scjax.camera.raycast"
    scene = validation_scenes(folder / "records", trained.codec, crop=Crop.FORWARD)[0]
    features = render(scene)
    streams = {"image": Stream.from_image(features.image), "depth": Stream.from_depth(features.depth)}
    condition = Condition(streams=streams, crop=Crop.FORWARD, num_lanes=5, num_agents=3)
    made = scjax.sample(jax.random.key(0), condition, model=trained, num_steps=2)
    validate(made)
    assert made.crop.tolist() == [Crop.FORWARD] and np.isfinite(made.lanes).all()


def test_training_batches_with_images_need_the_forward_crop(folder):
    config = LoaderConfig(crops=(1.0, 1.0, 0.0))
    with pytest.raises(ValueError, match="images show the forward window, but crops"):
        training_batches(folder / "records", ours(), config, images=RaycastImages())


def test_denoiser_objective_rejects_an_unknown_condition(folder):
    config = configured(folder)
    config.condition = "picture"
    with pytest.raises(ValueError, match='"none", "text" or "image"'):
        make_objective(config)
