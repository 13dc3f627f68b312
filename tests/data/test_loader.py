"""Batches: one bucket each, the same after a resume, and every example a function of (seed, index)."""

import numpy as np
import pytest

from scjax.data.loader import BatchLoader, PipelineConfig, bucket_of, clip_counts, training_batches, validation_scenes
from scjax.data.token_order import sort_tokens
from scjax.models.codec import official_nuplan, scjax
from scjax.scene import AgentType, Crop, Scene, unpadded, validate
from tests.factories.examples import example_scene
from tests.factories.worlds import make_records

CONFIG = PipelineConfig(batch_size=4, buckets=((8, 8), (20, 24), (61, 100)), seed=3)


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    return make_records(tmp_path_factory.mktemp("world"))


def equal(first: Scene, second: Scene) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(first.to_dict().values(), second.to_dict().values(), strict=True))


def take(batches: BatchLoader, number: int) -> list[Scene]:
    return [next(batches).scene for _ in range(number)]


def test_batches_are_valid_scenes_of_one_bucket(records):
    for batch in take(training_batches(records, scjax(), CONFIG), 6):
        assert batch.batch_shape == (4,)
        assert (batch.agent_mask.shape[1], batch.lane_mask.shape[1]) in CONFIG.buckets
        validate(batch)


def test_all_layouts_occur(records):
    crops = np.concatenate([batch.crop for batch in take(training_batches(records, scjax(), CONFIG), 10)])
    assert set(crops.tolist()) == set(Crop)


def test_resumes_to_the_very_next_batch(records):
    batches = training_batches(records, scjax(), CONFIG)
    take(batches, 5)
    state = batches.state()
    expected = take(batches, 4)
    again = training_batches(records, scjax(), CONFIG)
    again.restore(state)
    assert all(equal(a, b) for a, b in zip(expected, take(again, 4), strict=True))


def test_seed_decides_everything(records):
    first, second, other = (
        next(training_batches(records, scjax(), config)).scene
        for config in (CONFIG, CONFIG, PipelineConfig(batch_size=4, buckets=CONFIG.buckets, seed=4))
    )
    assert equal(first, second)
    assert not equal(first, other)


def test_processes_share_the_stream_and_the_bucket(records):
    parts = [next(training_batches(records, scjax(), CONFIG, process=i, processes=2)).scene for i in range(2)]
    assert [part.batch_shape for part in parts] == [(2,), (2,)]
    assert all(part.lane_mask.shape[1] == 100 for part in parts)
    assert not equal(*parts)


def test_validation_is_the_recorded_pose_in_token_order(records):
    scenes = validation_scenes(records, scjax())
    assert scenes
    assert all(equal(scene, other) for scene, other in zip(scenes, validation_scenes(records, scjax()), strict=True))
    for scene in scenes:
        validate(scene)
        assert np.array_equal(sort_tokens(scene)[1], np.arange(len(scene.agent_mask)))
        assert np.allclose(scene.agents[0, :2], 0, atol=1e-4)


def test_presets_drop_foreign_classes(records):
    scenes = validation_scenes(records, official_nuplan())
    assert not any((scene.agent_types == AgentType.CYCLIST).any() for scene in scenes)


def test_too_many_elements_are_cut_and_no_bucket_is_an_error():
    scene = unpadded(example_scene(agents=9, lanes=7))
    cut = clip_counts(scene, (4, 3))
    assert (len(cut.agent_mask), len(cut.lane_mask)) == (4, 3)
    with pytest.raises(ValueError, match="fits no bucket"):
        bucket_of(scene, ((4, 3),))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("batch_size", 0, "batch_size"),
        ("buckets", ((9, 9), (4, 4)), "smallest first"),
        ("crops", (0.0, 0.0, 0.0), "frequencies"),
    ],
)
def test_bad_config(field, value, message):
    with pytest.raises(ValueError, match=message):
        PipelineConfig(**{field: value})
