"""A crop of a log is the scene of a training record at the same pose."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.local_map import simplify_graph
from scjax.data.log_crop import crop_log
from scjax.data.readers.scene_json import read_log
from scjax.data.records import decode_record, encode_record, make_record, sample_scene
from scjax.data.tiles import find_poses
from scjax.scene import NO_EGO, OTHER_OBJECT, AgentType, Crop, Link, Signal, validate
from tests.factories import scene_files
from tests.factories.logs import example_log


@pytest.mark.parametrize("crop", list(Crop))
def test_crop_log_equals_record(tmp_path, crop):
    log = read_log(scene_files.write_scene_file(tmp_path))
    graph = build_graph(log)
    index = index_segments(graph)
    poses = find_poses(log, index, spacing=4.0)
    assert len(poses) > 3
    for pose in poses:
        record, _ = make_record(log, simplify_graph(graph), index, pose, 2)
        expected = sample_scene(decode_record(encode_record(record)), crop)
        scene = crop_log(log, pose.step, pose.object_index, crop=crop, domain=2)
        for name, value in expected.to_dict().items():
            np.testing.assert_array_equal(getattr(scene, name), value, err_msg=name)


def test_crop_log_is_centered_on_the_ego():
    scene = validate(crop_log(example_log(), 7))
    np.testing.assert_allclose(scene.agents[0], [0, 0, 0.8, 10, 1, 0, 4.5, 2, 1.6], atol=1e-6)
    assert scene.agent_types.tolist() == [AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.VEHICLE]
    assert scene.signals.tolist().count(Signal.STOP) == 1
    assert (scene.links == Link.LEFT).sum() == 1


def test_crop_log_around_another_object():
    scene = validate(crop_log(example_log(), 7, 1))
    np.testing.assert_allclose(scene.agents[0, 6:], [6.0, 2.4, 2.0], rtol=1e-6)


def test_crop_log_leaves_out_unseen_objects():
    assert len(crop_log(example_log(), 0).agents) == 2


@pytest.mark.parametrize(
    ("changes", "step", "object_index", "message"),
    [
        ({"ego_index": NO_EGO}, 0, None, "the log has no ego"),
        ({}, 10, None, "step is 10"),
        ({}, 0, 3, "object_index is 3"),
        ({}, 0, 2, r"object 2 is not valid at step 0: its valid steps are \[4, 5"),
        ({"object_types": np.array([OTHER_OBJECT, 0, 0])}, 0, None, "object 0 has no AgentType"),
        ({"lanes": ()}, 0, None, "no lane with two distinct points"),
    ],
)
def test_crop_log_fault_names_argument(changes, step, object_index, message):
    with pytest.raises(ValueError, match=message):
        crop_log(example_log(**changes), step, object_index)
