import dataclasses

import numpy as np
import pytest

from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.readers.scene_json import read_log
from scjax.data.tiles import agents_at, cut_tile, find_poses
from scjax.scene import AgentType
from tests.factories import scene_files


def prepared(tmp_path, scene=None):
    log = read_log(scene_files.write_scene_file(tmp_path, scene))
    graph = build_graph(log)
    return log, graph, index_segments(graph)


def test_find_poses_recording_car_first(tmp_path):
    log, _, index = prepared(tmp_path)
    poses = find_poses(log, index)
    # x = -20, -10 (too near), 0, 10 (too near); the van at step 0 is 10.6 m from the first, at step 30 it is at -3.
    assert [(p.step, p.object_index) for p in poses] == [(0, 0), (20, 0)]
    assert poses[0].is_recorder and poses[0].ground == pytest.approx(10.0)
    dense = find_poses(log, index, spacing=4.0, max_poses=40)
    assert [(p.step, p.object_index) for p in dense] == [(0, 0), (10, 0), (20, 0), (30, 0), (0, 1), (30, 1)]
    assert not dense[-1].is_recorder
    assert len(find_poses(log, index, spacing=4.0, max_poses=3)) == 3


def test_find_poses_extends_first_poses(tmp_path):
    log, _, index = prepared(tmp_path)
    first = find_poses(log, index)
    dense = find_poses(log, index, spacing=4.0, max_poses=40, first=first)
    assert dense[:2] == first and len(dense) == 6
    places = np.array([(p.x, p.y) for p in dense])
    gaps = np.linalg.norm(places[:, None] - places, axis=-1)[np.triu_indices(6, 1)]
    assert gaps.min() >= 4.0
    assert find_poses(log, index, max_poses=1, first=first) == first


def test_find_poses_needs_driving_vehicles(tmp_path):
    scene = scene_files.scene_content()
    scene["objects"] += [
        scene_files.moving_object((10, 8), (3.0, 0.0)),
        scene_files.moving_object((9, 1.7), (3.0, 0.0)),
    ]
    scene["objects"] += [scene_files.moving_object((20, 0), (12.0, 0.0))]
    scene["sdc_index"] = 8
    log, _, index = prepared(tmp_path, scene)
    # 0 and 1 are 40 m away; 2 is off the road; 6 faces oncoming traffic; 7 drives between two lanes.
    assert {p.object_index for p in find_poses(log, index, spacing=1.0, max_poses=99)} == {8}


def test_find_poses_without_recording_car(tmp_path):
    log, _, index = prepared(tmp_path, scene_files.scene_content(sdc_index=None))
    poses = find_poses(log, index, spacing=8.0)
    assert {p.object_index for p in poses} == {0, 1} and not any(p.is_recorder for p in poses)


@pytest.mark.parametrize("argument", ["spacing", "max_poses", "recorder_stride", "other_stride"])
def test_find_poses_refuses_bad_values(tmp_path, argument):
    log, _, index = prepared(tmp_path)
    with pytest.raises(ValueError, match=f"{argument} is 0"):
        find_poses(log, index, **{argument: 0.0 if argument == "spacing" else 0})


def test_agents_at_pose(tmp_path):
    log, graph, index = prepared(tmp_path)
    pose = find_poses(log, index)[1]
    agents = agents_at(log, index, pose, 32.0, square=True)
    assert agents.source[0] == 0 and 5 not in agents.source
    np.testing.assert_allclose(agents.states[0], [0, 0, 0.8, 10, 1, 0, 4.5, 2, 1.6], atol=1e-9)
    assert agents.off_road.tolist() == [source == 2 for source in agents.source]
    tile = cut_tile(log, graph, index, pose)
    assert AgentType.STATIC not in tile.agents.types[tile.all]
    assert tile.all.sum() == tile.main.sum() + 1


def test_pose_ground_from_lane(tmp_path):
    scene = scene_files.scene_content()
    scene["objects"][0] |= {"z": None}
    log, _, index = prepared(tmp_path, scene)
    assert find_poses(log, index)[0].ground == pytest.approx(10.0)
    scene["objects"][0] |= {"z": [10.8] * scene_files.STEPS, "height": None}
    log, _, index = prepared(tmp_path, scene)
    assert find_poses(log, index)[0].ground == pytest.approx(10.8)


def test_cut_tile_is_invariant_to_rigid_motion(tmp_path):
    log, graph, index = prepared(tmp_path)
    turn, shift = 0.7, np.array([-8330.0, 4711.0, -200.0])
    cos, sin = np.cos(turn), np.sin(turn)
    matrix = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    far = dataclasses.replace(
        log,
        positions=log.positions @ matrix + shift,
        headings=log.headings + turn,
        velocities=log.velocities @ matrix[:2, :2],
        lanes=tuple(dataclasses.replace(lane, points=lane.points @ matrix + shift) for lane in log.lanes),
    )
    far_graph = build_graph(far)
    far_index = index_segments(far_graph)
    for near_pose, far_pose in zip(find_poses(log, index), find_poses(far, far_index), strict=True):
        near_tile, far_tile = cut_tile(log, graph, index, near_pose), cut_tile(far, far_graph, far_index, far_pose)
        np.testing.assert_allclose(near_tile.lanes, far_tile.lanes, atol=1e-6)
        np.testing.assert_allclose(near_tile.agents.states, far_tile.agents.states, atol=1e-6)
        np.testing.assert_array_equal(near_tile.successors, far_tile.successors)
