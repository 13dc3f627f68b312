"""Exact overlap of boxes: hand-made pairs, symmetry, rigid motion, and the eval set's golden pairs."""

import numpy as np
import pytest
import shapely

from scjax.metrics.realism import overlapping_pairs, scene_realism
from scjax.scene.boxes import corners, intersection_areas, overlaps, separations
from tests.factories.traffic import agent, eval_tiles


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (agent(4, 0), False),  # nose to tail
        (agent(3.99, 0), True),
        (agent(0, 2), False),  # side to side
        (agent(0, 1.99), True),
        (agent(0, 0), True),
        (agent(3, 0, 90), False),  # a T: half a length and half a width away
        (agent(2.99, 0, 90), True),
        # A diamond at a corner: bounding boxes and circles overlap in both cases, the boxes in one.
        (agent(2.7, 1.7, 45, 0, (2, 2, 1)), True),
        (agent(2.8, 1.8, 45, 0, (2, 2, 1)), False),
    ],
)
def test_overlaps_hand_made_pairs(other, expected):
    np.testing.assert_array_equal(overlaps(np.stack([agent(0, 0), other])), [[False, expected], [expected, False]])


def test_separations_are_the_least_shifts_that_part_boxes():
    rng = np.random.default_rng(2)
    agents = np.stack([agent(*rng.uniform(-5, 5, 2), rng.uniform(-180, 180)) for _ in range(12)]).astype(np.float64)
    shifts, pairs = separations(agents), overlaps(agents)
    np.testing.assert_array_equal(np.abs(shifts).sum(-1) > 0, pairs)
    for one, other in zip(*np.nonzero(pairs), strict=True):
        for share, expected in ((1.001, False), (0.99, True)):
            pair = agents[[one, other]].copy()
            pair[1, :2] += share * shifts[one, other]
            assert overlaps(pair)[0, 1] == expected


def test_overlaps_is_invariant_to_motion_and_order():
    rng = np.random.default_rng(1)
    agents = np.stack([agent(*rng.uniform(-8, 8, 2), rng.uniform(-180, 180)) for _ in range(20)])
    before = overlaps(agents)
    assert before.any() and (before == before.T).all() and not before.diagonal().any()
    turn = 0.7
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    moved = agents.copy()
    moved[:, :2] = agents[:, :2] @ rotation.T + [5, -3]
    moved[:, 4:6] = agents[:, 4:6] @ rotation.T
    np.testing.assert_array_equal(overlaps(moved), before)
    order = rng.permutation(20)
    np.testing.assert_array_equal(overlaps(agents[order]), before[np.ix_(order, order)])


def test_overlaps_agrees_with_dense_points():
    """A box pair overlaps exactly if some point of a fine grid in one lies in the other (up to the grid)."""
    rng = np.random.default_rng(2)
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 81), np.linspace(-0.5, 0.5, 41))
    for _ in range(200):
        first, second = (agent(*rng.uniform(-3, 3, 2), rng.uniform(-180, 180)) for _ in range(2))
        ahead, side = first[4:6], np.array([-first[5], first[4]])
        points = first[:2] + u.reshape(-1, 1) * first[6] * ahead + v.reshape(-1, 1) * first[7] * side
        local = points - second[:2]
        local = np.stack([local @ second[4:6], local @ np.array([-second[5], second[4]])], -1)
        inside = np.abs(local) < second[6:8] / 2
        overlap = overlaps(np.stack([first, second]))[0, 1]
        shrunk = np.stack([first, second])
        shrunk[:, 6:8] -= 0.2
        assert overlap or not inside.all(-1).any()
        assert inside.all(-1).any() or not overlaps(shrunk)[0, 1]


def test_overlaps_golden(eval_dir, golden_designs):
    cases = golden_designs["obb"]
    tiles = {
        variant: eval_tiles(eval_dir, "real_train", variant=variant) for variant in {case["agents"] for case in cases}
    }
    assert cases
    for case in cases:
        tile = tiles[case["agents"]][case["tile"]]
        expected = [(i, j) for i, j, *_ in case["pairs"]]
        assert [tuple(pair) for pair in overlapping_pairs(tile).tolist()] == expected, case["tile"]
        ratios = scene_realism(tile)
        assert ratios["scenes_any_overlap"][0] == case["flags_scene_any_iou01_iou10_veh"][0]
        assert ratios["scenes_vehicle_overlap"][0] == case["flags_scene_any_iou01_iou10_veh"][3]


def test_intersection_areas_agree_with_shapely():
    rng = np.random.default_rng(0)
    turns = (0, 90, 180, None)  # parallel outlines are the hard case

    def boxes(count):
        headings = [rng.choice([t if t is not None else rng.uniform(-180, 180) for t in turns]) for _ in range(count)]
        return np.stack([agent(*rng.uniform(-2, 2, 2), h, 0, tuple(rng.uniform(0.5, 5, 3))) for h in headings])

    first, second = boxes(2000), boxes(2000)
    second[:50] = first[:50]  # the same box
    second[50:100] = first[50:100]  # and a shorter one on top of it
    second[50:100, 6] *= 0.5
    meet = np.array([overlaps(np.stack(pair))[0, 1] for pair in zip(first, second, strict=True)])
    assert 0.5 < meet.mean() < 1 and meet[:100].all()
    polygons = [shapely.polygons(corners(side[meet])) for side in (first, second)]
    area = intersection_areas(first[meet], second[meet])
    np.testing.assert_allclose(area, shapely.area(shapely.intersection(*polygons)), atol=1e-5)
    np.testing.assert_allclose(area, intersection_areas(second[meet], first[meet]), atol=1e-5)
