"""Made-up recordings: readable by the common reader, reproducible, and free of overlaps and gaps."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pytest
import shapely
import shapely.affinity

from scjax.data.__main__ import main
from scjax.data.procedural import make_scene, write_scenes
from scjax.data.procedural_roads import KINDS
from scjax.data.scene_json import RawScene, read_scene
from scjax.scene import AgentType, Signal

NUM_SCENES = 24


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> list[RawScene]:
    paths = write_scenes(tmp_path_factory.mktemp("made"), NUM_SCENES, seed=3)
    return [read_scene(path) for path in paths]


def test_files_appear_whole_and_read_back(tmp_path):
    paths = write_scenes(tmp_path, 2, seed=1)
    assert sorted((tmp_path / "procedural").iterdir()) == sorted(paths)
    raw = read_scene(paths[0])
    assert raw.domain == "procedural" and raw.topology_given and raw.recorder == 0 and raw.num_steps == 91


def test_a_scene_depends_on_seed_and_index_only(tmp_path):
    (_, second), (_, again, _) = write_scenes(tmp_path / "a", 2, seed=5), write_scenes(tmp_path / "b", 3, seed=5)
    assert second.read_bytes() == again.read_bytes()
    assert json.loads(gzip.decompress(second.read_bytes())) == json.loads(json.dumps(make_scene(5, 1)))
    assert make_scene(6, 1)["objects"] != make_scene(5, 1)["objects"]


def test_every_kind_occurs_with_its_own_map(scenes):
    assert {raw.scene_id.split("-")[0] for raw in scenes} == set(KINDS)
    assert len({raw.cluster for raw in scenes}) == NUM_SCENES


def test_joined_lanes_meet_and_topology_is_mutual(scenes):
    for raw in scenes:
        lanes = {lane.id: lane for lane in raw.lanes}
        for lane in raw.lanes:
            for after in lane.successors:
                assert lane.id in lanes[after].predecessors
                gap = np.linalg.norm(lane.points[-1] - lanes[after].points[0])
                assert gap < 1e-3, raw.scene_id
                last, first = lane.points[-1] - lane.points[-2], lanes[after].points[1] - lanes[after].points[0]
                cosine = last @ first / np.linalg.norm(last) / np.linalg.norm(first)
                assert cosine > 0.95, raw.scene_id
            for entries, mirror, sign in ((lane.left, "right", 1), (lane.right, "left", -1)):
                for other, start, end, *_ in entries:
                    assert lane.id in [entry[0] for entry in getattr(lanes[other], mirror)]
                    middle = (start + end) // 2
                    along = lane.points[middle + 1, :2] - lane.points[middle, :2]
                    aside = lanes[other].points[middle, :2] - lane.points[middle, :2]
                    left_of = (along[0] * aside[1] - along[1] * aside[0]) / np.hypot(*along)
                    assert sign * left_of == pytest.approx(3.6, abs=0.4)


def test_lanes_are_evenly_sampled_and_gently_graded(scenes):
    for raw in scenes:
        for lane in raw.lanes:
            steps = np.diff(lane.points, axis=0)
            lengths = np.hypot(steps[:, 0], steps[:, 1])
            assert 0.1 < lengths.min() and lengths.max() < 3.0
            assert np.abs(steps[:, 2] / lengths).max() < 0.09
            turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
            assert np.abs(turns).max() < 0.5


def _boxes(raw: RawScene, step: int) -> list[shapely.Polygon]:
    boxes = []
    for i in np.flatnonzero(raw.valid[:, step]):
        length, width, _ = raw.sizes[i]
        box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
        box = shapely.affinity.rotate(box, raw.headings[i, step], (0, 0), use_radians=True)
        boxes.append(shapely.affinity.translate(box, *raw.positions[i, step, :2]))
    return boxes


def test_nothing_ever_overlaps(scenes):
    for raw in scenes:
        for step in (0, 33, 77):
            boxes = _boxes(raw, step)
            pairs = shapely.STRtree(boxes).query(boxes, predicate="intersects").T
            assert all(i == j for i, j in pairs), (raw.scene_id, step)


def test_motion_agrees_with_velocity_and_heading(scenes):
    for raw in scenes:
        both = raw.valid[:, 1:-1] & raw.valid[:, :-2] & raw.valid[:, 2:]
        measured = (raw.positions[:, 2:, :2] - raw.positions[:, :-2, :2]) / 0.2
        error = np.linalg.norm(measured - raw.velocities[:, 1:-1], axis=-1)
        assert np.percentile(error[both], 99) < 0.5
        speed = np.linalg.norm(measured, axis=-1)
        fast = both & (speed > 1)
        heading = np.arctan2(measured[..., 1], measured[..., 0])
        off = np.abs(np.angle(np.exp(1j * (heading - raw.headings[:, 1:-1]))))
        assert np.percentile(off[fast], 99) < 0.15 if fast.any() else True
        assert speed[both].max() < 36


def test_agents_stand_on_the_ground_and_vehicles_follow_lanes(scenes):
    on_lanes = []
    for raw in scenes:
        points = np.concatenate([lane.points for lane in raw.lanes])
        for i in np.flatnonzero(raw.valid[:, 0]):
            gap = np.hypot(*(points[:, :2] - raw.positions[i, 0, :2]).T)
            ground = raw.positions[i, 0, 2] - raw.sizes[i, 2] / 2
            assert abs(ground - points[gap.argmin(), 2]) < 0.5
            if raw.types[i] == AgentType.VEHICLE and np.hypot(*raw.velocities[i, 0]) > 1:
                on_lanes.append(gap.min() < 1.6)
    assert np.mean(on_lanes) > 0.99


def test_the_ego_is_seen_throughout_at_most_places_of_its_drive(scenes):
    assert np.mean([raw.valid[0].mean() for raw in scenes]) > 0.95
    moved = [np.hypot(*np.ptp(raw.positions[0, raw.valid[0], :2], axis=0)) for raw in scenes]
    assert np.median(moved) > 40


def test_signals_are_consistent(scenes):
    lit = [raw for raw in scenes if raw.signal_lanes]
    assert lit and all(raw.scene_id.split("-")[0] in ("four_way", "t_junction") for raw in lit)
    for raw in lit:
        assert {Signal.GO, Signal.STOP} <= set(np.unique(raw.signals[:, 0])) <= {Signal.GO, Signal.STOP}
        lanes = {lane.id: lane for lane in raw.lanes}
        connectors = [shapely.LineString(lanes[name].points[:, :2]) for name in raw.signal_lanes]
        go = np.flatnonzero(raw.signals[:, 0] == Signal.GO)
        entries = [lanes[name].predecessors for name in raw.signal_lanes]
        for i in go:
            for j in go:
                # Movements out of one lane part at its end; those out of two must never meet.
                assert entries[i] == entries[j] or not connectors[i].crosses(connectors[j]), raw.scene_id


def test_variety_of_agents(scenes):
    types = np.concatenate([raw.types for raw in scenes])
    assert {AgentType.VEHICLE, AgentType.PEDESTRIAN, AgentType.CYCLIST} <= set(types.tolist())
    assert 6 < len(types) / NUM_SCENES < 40


def test_command_line(tmp_path, capsys):
    assert main(["procedural", str(tmp_path), "--scenes", "2", "--seed", "9"]) == 0
    assert "2 scenes in" in capsys.readouterr().out and len(list((tmp_path / "procedural").iterdir())) == 2
    assert main(["procedural", str(tmp_path), "--scenes", "0"]) == 1
    assert "at least one scene" in capsys.readouterr().err
