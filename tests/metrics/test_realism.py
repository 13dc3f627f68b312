"""Hand-made worlds whose faults can be counted."""

import math

import numpy as np
import pytest

from scjax.metrics.pooling import pool, values
from scjax.metrics.realism import connection_gaps, lane_offsets, overlapping_pairs, realism, scene_realism
from scjax.scene import AgentType, pad, stack
from tests.factories.traffic import agent, crossing, eval_tiles, lane, scene

ROAD = [lane((-32, 0), (0, 0)), lane((0, 0), (32, 0))]


def test_realism_of_a_flawless_scene():
    result = realism(crossing())
    assert result == {
        "connection_gap_m": 0,
        "open_connections": 0,
        "vehicles_on_lane": 1,
        "lane_angle_deg": 0,
        "off_heading": 0,
        "vehicles_overlapping": 0,
        "vehicle_overlap_pairs": 0,
        "scenes_vehicle_overlap": 0,
        "scenes_any_overlap": 0,
        "scenes_overlap_iou_0.01": 0,
        "scenes_overlap_iou_0.1": 0,
    }


def test_realism_counts_gaps_and_overlaps():
    pile = [agent(10, 0, 180), agent(11, 1, 180), agent(12, 0, 180)]
    faulty_scene = scene(
        [agent(10, 0), *pile[1:]],
        [lane((-32, 0), (0, 0)), lane((3, 4), (32, 0)), lane((32, 0.5), (40, 0))],
        joined=[(0, 1), (1, 2)],
    )
    result = realism(faulty_scene)
    np.testing.assert_allclose(connection_gaps(faulty_scene), [5, 0.5], atol=1e-6)
    assert result["connection_gap_m"] == pytest.approx(2.75) and result["open_connections"] == 0.5
    assert result["vehicles_overlapping"] == result["scenes_vehicle_overlap"] == result["scenes_any_overlap"] == 1
    assert result["vehicle_overlap_pairs"] == 3


def test_realism_counts_offsets_and_headings():
    faulty_scene = scene([agent(0, 0), agent(8, 1.4), agent(-8, 1.6), agent(16, 0, 180), agent(-16, 0.5, 30)], ROAD)
    distance, angle = lane_offsets(faulty_scene)
    np.testing.assert_allclose(distance, [0, 1.4, 1.6, 0, 0.5], atol=1e-6)
    np.testing.assert_allclose(angle, [0, 0, 0, 180, 30], atol=1e-3)
    result = realism(faulty_scene)
    assert result["vehicles_on_lane"] == 0.8 and result["off_heading"] == 0.25
    assert result["lane_angle_deg"] == pytest.approx(210 / 4, abs=1e-3)
    assert scene_realism(faulty_scene, ego=False)["vehicles_on_lane"] == (3, 4)


def test_realism_separates_vehicles_from_other_agents():
    people = [agent(10, 10, 0, 1, (0.6, 0.6, 1.7)), agent(10.3, 10, 0, 1, (0.6, 0.6, 1.7))]
    faulty_scene = scene([agent(0, 0), *people], ROAD, types=[AgentType.VEHICLE] + [AgentType.PEDESTRIAN] * 2)
    ratios = scene_realism(faulty_scene)
    assert ratios["vehicles_on_lane"] == (1, 1) and ratios["vehicles_overlapping"] == (0, 1)
    assert ratios["scenes_any_overlap"] == (1, 1) and ratios["scenes_vehicle_overlap"] == (0, 1)
    np.testing.assert_array_equal(overlapping_pairs(faulty_scene), [[1, 2]])


def test_realism_without_lanes_or_vehicles():
    assert values(scene_realism(scene([agent(0, 0)])))["vehicles_on_lane"] == 0
    alone = values(scene_realism(scene([agent(0, 0)]), ego=False))
    assert math.isnan(alone["vehicles_on_lane"]) and math.isnan(alone["connection_gap_m"])
    assert alone["scenes_any_overlap"] == 0


def test_realism_ignores_boxes_of_unknown_size():
    faulty_scene = scene([agent(0, 0), agent(1, 0)], ROAD)
    known = faulty_scene.agent_known.copy()
    known[1, 6:9] = False
    assert realism(faulty_scene)["scenes_vehicle_overlap"] == 1
    assert scene_realism(faulty_scene.replace(agent_known=known))["vehicles_overlapping"] == (0, 1)


def test_realism_ignores_batching_and_padding():
    scenes = [crossing(), scene([agent(0, 0), agent(1, 1)], ROAD, joined=[(0, 1)]), scene([agent(0, 0), agent(9, 9)])]
    streamed = realism(pad(s, 9, 9) for s in scenes)
    assert realism(stack(scenes)) == streamed
    assert values(pool([pool(map(scene_realism, scenes[:1])), pool(map(scene_realism, scenes[1:]))])) == streamed


def test_golden_connections_of_real_tiles_are_closed(eval_dir):
    result = realism(eval_tiles(eval_dir, "train", only=list(range(0, 1239, 40))))
    assert result["connection_gap_m"] < 1e-4 and result["open_connections"] == 0
    assert result["vehicles_on_lane"] > 0.85
    peers = realism(eval_tiles(eval_dir, "peer_vehicle"))
    assert peers["connection_gap_m"] == pytest.approx(0.18, abs=0.005)  # baselines.md §1
    assert peers["scenes_any_overlap"] == 0  # their overlapping agents were removed
