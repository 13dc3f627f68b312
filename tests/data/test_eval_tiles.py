"""The shared evaluation tiles, cut again from the recordings: every scene, every pose, every number."""

import csv

import numpy as np
import pytest

from scjax.data import records
from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.local_map import simplify_graph
from scjax.data.readers.scene_json import read_log
from scjax.data.tiles import cut_tile, find_poses
from scjax.scene import Link, validate

TOLERANCE = 1e-3  # m


@pytest.fixture(scope="module")
def golden(eval_dir, data_dir):
    with np.load(eval_dir / "tiles_real_train.npz") as arrays:
        return dict(arrays)


def rows(golden, name, offsets, tile):
    return golden[name][slice(*golden[offsets][tile : tile + 2])]


def check_tile(golden, tile, ours, pose):
    lanes = rows(golden, "lanes_xy", "lane_offsets", tile)
    assert len(lanes) == len(ours.lanes)
    np.testing.assert_allclose(ours.lanes[..., :2], lanes, atol=TOLERANCE)
    np.testing.assert_allclose(ours.lanes[..., 2], rows(golden, "lanes_z", "lane_offsets", tile), atol=TOLERANCE)
    edges = rows(golden, "edges", "edge_offsets", tile)
    assert sorted(map(tuple, edges)) == sorted(map(tuple, ours.successors))
    listed = ours.main | ours.all
    agents = rows(golden, "agents", "agent_offsets", tile)
    np.testing.assert_allclose(ours.agents.states[listed], agents, atol=TOLERANCE)
    columns = {
        "agent_type": ours.agents.types,
        "agent_source": ours.agents.source,
        "agent_main": ours.main,
        "agent_all": ours.all,
    }
    for name, values in columns.items():
        np.testing.assert_array_equal(values[listed], rows(golden, name, "agent_offsets", tile), err_msg=name)
    distance = rows(golden, "agent_lane_dist", "agent_offsets", tile)
    np.testing.assert_allclose(ours.agents.lane_distance[listed], distance, atol=TOLERANCE)
    pose_values = [pose.x, pose.y, pose.yaw, pose.ground]
    np.testing.assert_allclose(pose_values, golden["tile_pose"][tile], atol=1e-5)
    assert (pose.step, pose.object_index) == (golden["tile_step"][tile], golden["tile_object"][tile])
    assert pose.is_recorder == golden["tile_is_sdc"][tile]


def max_distance(points, line):
    """Greatest distance of ``points`` [n, 2] from the polyline ``line`` [m, 2], extended by 5 cm at both ends."""
    ends = np.stack([line[0] - line[1], line[-1] - line[-2]])
    ends *= 0.05 / np.linalg.norm(ends, axis=1, keepdims=True)
    line = np.concatenate([line[:1] + ends[:1], line, line[-1:] + ends[1:]])
    start, delta = line[:-1], np.diff(line, axis=0)
    ratio = (((points[:, None] - start) * delta).sum(-1) / np.maximum((delta**2).sum(-1), 1e-18)).clip(0, 1)
    return np.linalg.norm(points[:, None] - start - ratio[..., None] * delta, axis=-1).min(1).max()


def check_record(record, tile):
    """The scene of a record is the tile, up to the order of equally near lanes; returns the number of grazing lanes."""
    scene = validate(records.sample_scene(records.decode_record(records.encode_record(record))))
    assert len(scene.lanes) == len(tile.lanes) and len(scene.agents) == tile.main.sum()
    error = np.abs(scene.lanes[:, None, :, :2] - tile.lanes[None, ..., :2]).max((2, 3))
    match = error.argmin(1)
    assert len(set(match.tolist())) == len(match)
    distance = np.hypot(tile.lanes[..., 0], tile.lanes[..., 1]).min(1)
    assert (np.diff(distance[match]) > -TOLERANCE).all()
    grazing = np.flatnonzero(error.min(1) > TOLERANCE)
    for lane in grazing:
        # Where a lane runs almost along the border, 0.1 mm sideways move its end by millimeters along the lane.
        assert max_distance(scene.lanes[lane, :, :2].astype(float), tile.lanes[match[lane], :, :2]) < TOLERANCE
        assert error[lane].min() < 0.05
    known = scene.lane_known[:, 2]
    np.testing.assert_array_equal(known, ~np.isnan(tile.lanes[match, 0, 2]))
    np.testing.assert_allclose(scene.lanes[known][..., 2], tile.lanes[match][known][..., 2], atol=2 * TOLERANCE)
    joined = np.zeros((len(match),) * 2, bool)
    joined[tuple(tile.successors[tile.successors[:, 0] != tile.successors[:, 1]].T)] = True
    np.testing.assert_array_equal(scene.links == Link.PREDECESSOR, joined[np.ix_(match, match)])
    agents = np.where(scene.agent_known, tile.agents.states[tile.main], scene.agents)
    agents[:, 3] = np.minimum(agents[:, 3], 35.0)
    np.testing.assert_allclose(scene.agents, agents, atol=TOLERANCE)
    np.testing.assert_array_equal(scene.agent_types, tile.agents.types[tile.main])
    return len(grazing)


def test_eval_tiles_golden(golden, eval_dir, data_dir):
    """Per scene: counts as in counts_real_train.csv, tiles as stored, and records that give the same scene."""
    with (eval_dir / "counts_real_train.csv").open() as file:
        counts = {row["scene_id"]: row for row in csv.DictReader(file)}
    assert set(counts) == set(golden["scene_id"].tolist())
    grazing = lanes = 0
    for number, scene_id in enumerate(golden["scene_id"]):
        log = read_log(data_dir / "womd" / f"{scene_id}.json.gz")
        graph = build_graph(log)
        index = index_segments(graph)
        simplified = simplify_graph(graph)
        total = dict.fromkeys(("tiles", "lanes", "edges", "agents_main", "agents_all"), 0)
        for tile, pose in zip(np.flatnonzero(golden["tile_scene"] == number), find_poses(log, index), strict=True):
            ours = cut_tile(log, graph, index, pose)
            check_tile(golden, tile, ours, pose)
            grazing += check_record(records.make_record(log, simplified, index, pose, 0)[0], ours)
            sizes = (1, len(ours.lanes), len(ours.successors), ours.main.sum(), ours.all.sum())
            total = {name: total[name] + int(size) for name, size in zip(total, sizes, strict=True)}
        row = counts[scene_id]
        assert total == {name: int(row[name]) for name in total}, scene_id
        assert row["cluster"] == log.metadata.location_cluster
        lanes += total["lanes"]
    assert lanes == len(golden["lanes_xy"])
    assert grazing < 2e-3 * lanes, grazing
