"""The match rule on hand-made agents and on the eval set's golden cases; the baseline that only knows the lanes."""

import math

import numpy as np
import pytest

from scjax.metrics.placement import match, match_rate, match_summary, placement, random_lane_aligned, vehicle_pool
from scjax.metrics.pooling import pool
from scjax.metrics.realism import lane_offsets
from scjax.scene import AgentType, pad, permute, validate
from tests.factories.traffic import agent, crossing, eval_tiles, lane, scene

EGO = agent(0, 0)


def test_match_of_a_copy_ignores_order_and_padding():
    source_scene = crossing()
    result = placement(
        [
            (source_scene, source_scene),
            (pad(source_scene, 9, 9), permute(source_scene, np.array([0, 3, 1, 2]), np.arange(3))),
        ]
    )
    assert set(result.values()) == {1.0}


def test_match_thresholds_are_strict_and_averaged():
    reference, generated = scene([EGO, agent(10, 0)]), scene([EGO, agent(11, 0)])
    result = placement([(reference, generated)])
    assert (result["recall_1m"], result["recall_2m"], result["recall_3m"]) == (0, 1, 1)
    assert result["M"] == result["P"] == pytest.approx(2 / 3) and result["PxR"] == pytest.approx(2 / 3)


def test_match_leaves_the_ego_out():
    assert math.isnan(match_rate(scene([EGO]), scene([EGO])))
    assert match_rate(scene([EGO, agent(9, 9)]), scene([EGO])) == 0
    # An agent on the ego's place matches nothing either.
    assert match_rate(scene([EGO, agent(9, 9)]), scene([EGO, agent(0, 0)])) == 0


def test_match_uses_each_agent_once():
    reference = scene([EGO, agent(10, 0), agent(12.5, 0)])
    generated = scene([EGO, agent(11, 0), agent(10, 0), agent(10, 0)])
    ratios = match(reference, generated)
    assert ratios["recall_1m"] == (1, 2)  # the second takes x = 10
    assert ratios["recall_2m"] == (1, 2)  # the first takes x = 10, 12.5 is out of the second's reach
    assert ratios["recall_3m"] == (2, 2) and ratios["precision_3m"] == (2, 3)


def test_match_separates_classes():
    agent_types = [AgentType.VEHICLE, AgentType.CYCLIST]
    reference, generated = scene([EGO, agent(9, 0)], types=agent_types), scene([EGO, agent(9, 0)])
    assert match_rate(reference, generated) == 0
    assert match(reference, generated, agnostic=True)["recall_1m"] == (1, 1)
    assert match(reference, generated, types=[AgentType.VEHICLE])["precision_1m"] == (0, 1)


def test_placement_of_a_stream_equals_pooled_parts():
    rng = np.random.default_rng(0)
    pairs = [
        (
            scene([EGO, *(agent(*rng.uniform(-9, 9, 2)) for _ in range(6))]),
            scene([EGO, *(agent(*rng.uniform(-9, 9, 2)) for _ in range(5))]),
        )
        for _ in range(6)
    ]
    parts = [pool(match(*pair) for pair in part) for part in (pairs[:2], pairs[2:])]
    assert match_summary(pool(parts)) == placement(iter(pairs))


def test_golden_match(eval_dir, golden_designs):
    cases = golden_designs["match"]
    assert cases
    for case in cases:
        reference, generated = (
            eval_tiles(
                eval_dir,
                {"train": "real_train"}.get(side["set"], side["set"]),
                variant=side.get("agents", "main"),
                only=side["tiles"],
            )
            for side in (case["ref"], case["gen"])
        )
        pairs = zip(reference, generated, strict=True)
        ratios = pool(match(r, g, generated_ego=case["gen"]["set"] != "peer") for r, g in pairs)
        assert [ratios[f"recall_{m}m"][0] for m in (1, 2, 3)] == case["tp_array_order_1_2_3m"], case["name"]
        assert (ratios["recall_1m"][1], ratios["precision_1m"][1]) == (case["n_gt"], case["n_pred"])
        result = match_summary(ratios)
        for ours, theirs in (("M", "M_R"), ("P", "P"), ("PxR", "PxR")):
            assert result[ours] == pytest.approx(case[theirs], rel=1e-12), (case["name"], ours)


def test_random_placement_is_uniform_over_lane_length():
    lanes = [lane((-32, 0), (16, 0), z=1), lane((20, -8), (20, 8))]
    pool_rows = np.array([[5.0, 4, 2, 1.5], [9, 10, 2.5, 3]])
    crowd = [agent(30, 30) for _ in range(40)]
    person = agent(5, 5, 0, 1, (0.6, 0.6, 1.7))
    source_scene = scene([EGO, *crowd, person], lanes, types=[AgentType.VEHICLE] * 41 + [AgentType.PEDESTRIAN])
    rng = np.random.default_rng(0)
    placed = [validate(random_lane_aligned(rng, pad(source_scene, 60, 4), pool_rows)) for _ in range(30)]
    assert all(len(placed_scene.agent_mask) == 41 for placed_scene in placed)  # the pedestrian is left out
    for placed_scene in placed[:3]:
        np.testing.assert_array_equal(placed_scene.agents[0], EGO)
        np.testing.assert_array_equal(placed_scene.lanes, source_scene.lanes)
        distance, angle = lane_offsets(placed_scene, ego=False)
        assert distance.max() < 1e-5 and angle.max() < 1e-3
        np.testing.assert_array_equal(placed_scene.agents[1:, [3, 6, 7, 8]][:, 0] == 5, placed_scene.agents[1:, 6] == 4)
    agents = np.concatenate([placed_scene.agents[1:] for placed_scene in placed])
    assert np.mean(agents[:, 0] < 17) == pytest.approx(48 / 64, abs=0.05)
    assert np.mean(agents[:, 3] == 5) == pytest.approx(0.5, abs=0.05)
    on_first = agents[agents[:, 0] < 17]
    assert np.std(on_first[:, 0]) == pytest.approx(48 / np.sqrt(12), rel=0.06)
    np.testing.assert_allclose(on_first[:, 2], 1 + on_first[:, 8] / 2, atol=1e-6)


def test_vehicle_pool_excludes_ego_and_unknown_values():
    source_scene = crossing()
    np.testing.assert_allclose(vehicle_pool([source_scene, source_scene]), [[5, 4, 2, 1.5]] * 2)
    unknown = source_scene.agent_known.copy()
    unknown[1, 8] = False
    assert vehicle_pool(source_scene.replace(agent_known=unknown)).shape == (0, 4)


def test_random_placement_names_missing_input():
    rng, rows = np.random.default_rng(0), np.ones((1, 4))
    with pytest.raises(ValueError, match="no lane with a length above 0"):
        random_lane_aligned(rng, scene([EGO, EGO]), rows)
    with pytest.raises(ValueError, match="pool of vehicles is empty"):
        random_lane_aligned(rng, crossing(), rows[:0])
