"""Trainings on windows that are encoded once: the same loss as by the loader's, batches, and what is refused."""

from __future__ import annotations

import itertools
from typing import Any, cast

import chex
import jax
import numpy as np
import pytest

import scjax
from experiments.studies.ablation.fixed_scenes import EncodedWindows, FixedScenesObjective, WindowBatches
from scjax.data import records
from scjax.data.loader import TrainingExample, batch_of, validation_scenes
from scjax.models.autoencoder.outputs import Posterior
from scjax.nn.random import row_keys
from scjax.scene import Crop
from scjax.scene.per_type import PerType
from scjax.train.loop import train
from scjax.train.objectives.denoiser import DenoiserObjective
from tests.factories.picture_features import save_features
from tests.factories.small_runs import get_config
from tests.factories.worlds import tiny_model


@pytest.fixture(scope="module")
def folder(tmp_path_factory, world_records):
    """Records, features of their pictures, and an autoencoder."""
    folder = tmp_path_factory.mktemp("fixed")
    (folder / "records").symlink_to(world_records)
    scjax.save(tiny_model().without("denoiser"), folder / "autoencoder")
    names = [
        f"{split}-{row:06d}"
        for split in ("train", "val")
        for row in range(len(records.open_records(world_records, split)))
    ]
    (folder / "features").mkdir()
    save_features(folder / "features", names)
    return folder


def fixed_config(folder):
    config = get_config("denoiser")
    config.records, config.autoencoder = str(folder / "records"), str(folder / "autoencoder")
    config.batch.crops, config.batch.jitter_position, config.batch.jitter_heading = (0.0, 0.0, 1.0), 0.0, 0.0
    config.batch.buckets = ((16, 16),)
    config.loss.known_lanes_share = config.loss.known_region_share = 0.0
    config.steps, config.checkpoint_every, config.evaluate_every, config.picture_every = 2, 2, 0, 0
    return config


def test_encoded_windows_have_the_loss_of_windows_from_the_loader(folder):
    config = fixed_config(folder)
    plain = DenoiserObjective.from_config(config)
    fixed: Any = FixedScenesObjective.from_config(config)
    scenes = validation_scenes(
        config.records, plain.codec, crop=Crop.FORWARD, split="train", bucket=plain.loader.buckets[0]
    )
    batch = batch_of([TrainingExample(scene=scene) for scene in scenes[:2]], plain.loader.buckets[0])
    encoded = jax.tree.map(lambda x: x[:2], fixed.windows)
    params, keys = plain.init(jax.random.key(1)), row_keys(jax.random.key(2), np.arange(2))
    expected, loss = jax.jit(plain.loss)(params, batch, keys), jax.jit(fixed.loss)(params, encoded, keys)
    assert loss[0] > 0
    chex.assert_trees_all_close(loss, expected, rtol=1e-5)


def test_training_on_encoded_windows_reads_pictures(folder, tmp_path):
    config = fixed_config(folder)
    config.condition, config.images, config.image_depth = "image", str(folder / "features"), False
    config.optimizer.warmup, config.cross_attention = 1, "full"
    objective: Any = FixedScenesObjective.from_config(config)
    train(config, tmp_path / "run", objective)
    model = scjax.load(tmp_path / "run" / "model")
    assert model.image_encoder == "of a test" and model.notes["steps"] == 2


def windows_of(number):
    """Windows that hold their own number and nothing else."""
    numbers = np.arange(number)
    values = PerType(agents=numbers[:, None, None].astype(np.float32), lanes=numbers[:, None, None].astype(np.float32))
    masks = PerType(agents=np.ones((number, 1), bool), lanes=np.ones((number, 1), bool))
    posterior = Posterior(mean=values, logvar=values, lane_count_logits=values.agents[:, 0])
    return EncodedWindows(posterior=posterior, masks=masks, crop=numbers, domain=numbers, index=numbers)


def test_batches_show_every_window_once_an_epoch():
    batches = WindowBatches(windows_of(6), 2, 0)
    epochs = [np.concatenate([next(batches).crop for _ in range(3)]) for _ in range(2)]
    assert all(sorted(epoch) == list(range(6)) for epoch in epochs) and list(epochs[0]) != list(epochs[1])


def test_batches_resume_at_the_next_one():
    batches = WindowBatches(windows_of(7), 2, 3)
    for _ in range(4):
        next(batches)
    again = WindowBatches(windows_of(7), 2, 3)
    again.restore(batches.state())
    for _ in range(3):
        chex.assert_trees_all_equal(next(again), next(batches))


def test_rows_of_batches_have_numbers_of_their_own():
    batches = WindowBatches(windows_of(4), 2, 0)
    numbers = np.concatenate([cast(np.ndarray, one.index) for one in itertools.islice(batches, 5)])
    assert list(numbers) == list(range(10))


def test_batches_need_enough_windows():
    with pytest.raises(ValueError, match="fewer than a batch"):
        WindowBatches(windows_of(1), 2, 0)


@pytest.mark.parametrize(
    ("section", "field", "value", "message"),
    [
        ("batch", "jitter_position", 2.0, "without jitter"),
        ("batch", "crops", (1.0, 0.0, 1.0), "without jitter"),
        ("batch", "buckets", ((8, 8), (16, 16)), "one padded size"),
        ("loss", "known_region_share", 0.1, "no known elements"),
    ],
)
def test_windows_that_change_are_refused(folder, section, field, value, message):
    config = fixed_config(folder)
    config[section][field] = value
    with pytest.raises(ValueError, match=message):
        FixedScenesObjective.from_config(config)
