"""Batches of one bucket, the same after a resume and for every number of processes."""

import chex
import jax
import numpy as np
import pytest

from scjax.data.loader import BatchLoader, LoaderConfig, clip_counts, scene_bucket, training_batches, validation_scenes
from scjax.data.token_order import sort_tokens
from scjax.models.codec import official_nuplan, scjax
from scjax.scene import AgentType, Crop, Scene, unpadded, validate
from tests.factories.examples import example_scene

CONFIG = LoaderConfig(batch_size=4, buckets=((8, 8), (20, 24), (61, 100)), seed=3)


@pytest.fixture(scope="module")
def records(world_records):
    return world_records


def equal(first: Scene, second: Scene) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(first.to_dict().values(), second.to_dict().values(), strict=True))


def take(batches: BatchLoader, number: int) -> list[Scene]:
    return [next(batches).scene for _ in range(number)]


def test_loader_batches_are_valid_scenes_of_one_bucket(records):
    for batch in take(training_batches(records, scjax(), CONFIG), 6):
        assert batch.batch_shape == (4,)
        assert (batch.agent_mask.shape[1], batch.lane_mask.shape[1]) in CONFIG.buckets
        validate(batch)


def test_loader_yields_every_crop(records):
    crops = np.concatenate([batch.crop for batch in take(training_batches(records, scjax(), CONFIG), 10)])
    assert set(crops.tolist()) == set(Crop)


def test_loader_resumes_to_the_very_next_batch(records):
    batches = training_batches(records, scjax(), CONFIG)
    take(batches, 5)
    state = batches.state()
    expected = take(batches, 4)
    again = training_batches(records, scjax(), CONFIG)
    again.restore(state)
    assert all(equal(a, b) for a, b in zip(expected, take(again, 4), strict=True))


def test_loader_depends_on_its_seed(records):
    first, second, other = (
        next(training_batches(records, scjax(), config)).scene
        for config in (CONFIG, CONFIG, LoaderConfig(batch_size=4, buckets=CONFIG.buckets, seed=4))
    )
    assert equal(first, second)
    assert not equal(first, other)


@pytest.mark.parametrize("resume", [False, True])
def test_loader_processes_share_the_stream_of_one(records, resume):
    """Rows [p::2] of every batch, in the same buckets."""
    alone = training_batches(records, scjax(), CONFIG)
    parts = [training_batches(records, scjax(), CONFIG, process=p, processes=2) for p in range(2)]
    if resume:
        take(alone, 3)
        for part in parts:
            part.restore(alone.state())
    for _ in range(6):
        whole = next(alone)
        for process, part in enumerate(parts):
            chex.assert_trees_all_equal(jax.tree.map(lambda x, p=process: x[p::2], whole), next(part))
    assert all(part.state() == alone.state() for part in parts)


def test_loader_uses_every_bucket_with_processes(records):
    batches = training_batches(records, scjax(), CONFIG, process=1, processes=2)
    assert len({scene.lane_mask.shape[1] for scene in take(batches, 12)}) > 1


def test_loader_refuses_a_batch_that_processes_cannot_share(records):
    with pytest.raises(ValueError, match="batch_size 4 does not divide over 3 processes"):
        training_batches(records, scjax(), CONFIG, processes=3)


def test_every_example_of_the_stream_occurs_once(records):
    batches = training_batches(records, scjax(), CONFIG)
    indices = np.concatenate([next(batches).index for _ in range(12)]).tolist()
    waiting = [index for queue in batches.state()["waiting"].values() for index in queue]
    assert sorted(indices + waiting) == list(range(batches.state()["next"]))


def test_validation_scenes_keep_the_recorded_pose(records):
    scenes = validation_scenes(records, scjax())
    assert scenes
    assert all(equal(scene, other) for scene, other in zip(scenes, validation_scenes(records, scjax()), strict=True))
    for scene in scenes:
        validate(scene)
        assert np.array_equal(sort_tokens(scene)[1], np.arange(len(scene.agent_mask)))
        assert np.allclose(scene.agents[0, :2], 0, atol=1e-4)


def test_validation_scenes_drop_classes_of_other_codecs(records):
    scenes = validation_scenes(records, official_nuplan())
    assert not any((scene.agent_types == AgentType.CYCLIST).any() for scene in scenes)


def test_clip_counts_cuts_to_the_bucket():
    cut = clip_counts(unpadded(example_scene(agents=9, lanes=7)), (4, 3))
    assert (len(cut.agent_mask), len(cut.lane_mask)) == (4, 3)


def test_bucket_of_a_larger_scene_is_an_error():
    with pytest.raises(ValueError, match="fits no bucket"):
        scene_bucket(unpadded(example_scene(agents=9, lanes=7)), ((4, 3),))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("batch_size", 0, "batch_size"),
        ("buckets", ((9, 9), (4, 4)), "smallest first"),
        ("crops", (0.0, 0.0, 0.0), "frequencies"),
    ],
)
def test_loader_config_rejects_bad_values(field, value, message):
    with pytest.raises(ValueError, match=message):
        LoaderConfig(**{field: value})
