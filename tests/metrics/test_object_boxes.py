"""Signed distances of boxes against shapely, times to collision and kinematics by hand."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.metrics.kinematics import kinematics
from scjax.metrics.object_boxes import (
    CORNER_ROUNDING,
    FAR,
    center_distances,
    corner_points,
    nearest_object_distances,
    object_boxes,
    signed_box_distances,
)
from scjax.metrics.road_distance import RoadDistance
from scjax.metrics.time_to_collision import MAX_TIME_TO_COLLISION, times_to_collision
from scjax.scene import MapLane
from tests.factories.motion_logs import select_objects, straight_log, traffic_log


def random_pairs(count=300):
    rng = np.random.default_rng(0)
    centers = (rng.uniform(-4, 4, (count, 2)), rng.uniform(-4, 4, (count, 2)))
    headings = (rng.uniform(-4, 4, count), rng.uniform(-4, 4, count))
    half = (rng.uniform(0.3, 3, (count, 2)), rng.uniform(0.3, 3, (count, 2)))
    return centers, headings, half


def boxes_of(log):
    boxes = object_boxes(log)
    rows = np.arange(log.num_objects)
    return boxes, rows, center_distances(boxes, rows)


@pytest.mark.parametrize("rounding", [0.0, CORNER_ROUNDING, 1.0])
def test_distances_of_apart_boxes_are_those_of_shapely(rounding):
    shapely = pytest.importorskip("shapely")
    centers, headings, half = random_pairs()
    radii = [rounding * side.min(-1) for side in half]
    cores = [
        [shapely.Polygon(c) if min(s) > 0 else shapely.LineString(c) for c, s in zip(points, sides, strict=True)]
        for points, sides in (
            (corner_points(centers[k], headings[k], half[k] - radii[k][:, None]), half[k] - radii[k][:, None])
            for k in (0, 1)
        )
    ]
    expected = np.array([a.distance(b) for a, b in zip(*cores, strict=True)])
    actual = signed_box_distances(centers, headings, half, rounding) + radii[0] + radii[1]
    apart = expected > 0
    assert apart.sum() > 50 and (~apart).sum() > 2
    np.testing.assert_allclose(actual[apart], expected[apart], atol=1e-9)
    assert (actual[~apart] <= 1e-9).all()


def test_overlapping_boxes_are_parted_by_their_signed_distance():
    shapely = pytest.importorskip("shapely")
    centers, headings, half = random_pairs()
    depth = -signed_box_distances(centers, headings, half, 0.0)
    for k in np.flatnonzero(depth > 0.05)[:40]:
        first = shapely.Polygon(corner_points(centers[0][k : k + 1], headings[0][k : k + 1], half[0][k : k + 1])[0])
        angles = np.linspace(0, 2 * np.pi, 721)
        for shift, parts in ((depth[k] * 1.01, True), (depth[k] * 0.95, False)):
            moves = centers[1][k] + shift * np.stack([np.cos(angles), np.sin(angles)], -1)
            same = np.ones(len(moves))
            corners = corner_points(moves, headings[1][k] * same, half[1][k] * same[:, None])
            others = [shapely.Polygon(points) for points in corners]
            assert any(first.intersection(other).area < 1e-9 for other in others) == parts


def test_distances_do_not_depend_on_the_order_of_a_pair():
    centers, headings, half = random_pairs()
    swapped = signed_box_distances(centers[::-1], headings[::-1], half[::-1])
    np.testing.assert_allclose(swapped, signed_box_distances(centers, headings, half), atol=1e-12)


def test_nearest_distance_is_the_least_over_all_pairs():
    log = traffic_log(3, objects=9)
    boxes, rows, apart = boxes_of(log)
    expected = np.full(boxes.valid.shape, FAR)
    for i in rows:
        for j in rows:
            for t in range(log.num_steps):
                if i != j and boxes.valid[i, t] and boxes.valid[j, t]:
                    pair = signed_box_distances(
                        (boxes.positions[i, t][None], boxes.positions[j, t][None]),
                        (boxes.headings[i, t][None], boxes.headings[j, t][None]),
                        (boxes.half[i][None], boxes.half[j][None]),
                    )
                    expected[i, t] = min(expected[i, t], pair[0])
    actual = nearest_object_distances(boxes, rows, apart)
    np.testing.assert_allclose(actual[boxes.valid], expected[boxes.valid], atol=1e-9)


def test_nearest_distance_of_a_single_object_is_far():
    boxes, rows, apart = boxes_of(straight_log((0, 0, 0, 5)))
    assert (nearest_object_distances(boxes, rows, apart) == FAR).all()


def times_of(log):
    boxes, rows, apart = boxes_of(log)
    speeds = kinematics(boxes.positions, boxes.headings, boxes.valid, boxes.dt).speed
    return times_to_collision(boxes, rows, apart, speeds)


def test_time_to_collision_is_gap_over_closing_speed():
    times = times_of(straight_log((0, 0, 0, 10), (30, 0, 0, 4)))
    assert times[0, 10] == pytest.approx((30 - 4 - 0.6 * 10) / 6)
    assert (times[1] == MAX_TIME_TO_COLLISION).all()
    assert times[0, 0] == MAX_TIME_TO_COLLISION, "the speed of the first step is not known"


@pytest.mark.parametrize(
    ("other", "follows"),
    [
        ((20, 0, 0, 1), True),
        ((20, 0, 80, 1), False),  # crosses
        ((20, 1.8, 0, 1), True),  # overlaps by 0.2 m, parallel
        ((20, 1.8, 12, 1), True),  # overlaps by 0.6 m
        ((20, 2.1, 12, 0), False),  # overlaps little, not parallel
        ((20, 3.0, 0, 1), False),  # beside
        ((-20, 0, 0, 1), False),  # behind
        ((20, 0, 0, 12), False),  # faster
        ((120, 0, 0, 1), False),  # far
    ],
)
def test_time_to_collision_counts_only_what_an_object_follows(other, follows):
    time = times_of(straight_log((0, 0, 0, 10), other, steps=5))[0, 1]
    assert (time < MAX_TIME_TO_COLLISION) == follows


def test_times_to_collision_take_the_nearest_of_several():
    log = straight_log((0, 0, 0, 10), (40, 0, 0, 0), (20, 0, 0, 5), steps=5)
    assert times_of(log)[0, 1] == pytest.approx(times_of(select_objects(log, [0, 2]))[0, 1])


def test_kinematics_of_a_circle():
    radius, rate, time = 20.0, 0.3, np.arange(60) * 0.1
    angle = rate * time + 3.0
    positions = radius * np.stack([np.cos(angle), np.sin(angle)], -1)[None]
    headings = ((angle + np.pi / 2 + np.pi) % (2 * np.pi) - np.pi)[None]
    motion = kinematics(positions, headings, np.ones((1, 60), bool), 0.1)
    assert np.isnan(motion.speed[0, [0, -1]]).all() and np.isnan(motion.acceleration[0, [0, 1, -2, -1]]).all()
    np.testing.assert_allclose(motion.speed[0, 1:-1], radius * np.sin(rate * 0.1) / 0.1)
    np.testing.assert_allclose(motion.angular_speed[0, 1:-1], rate)
    np.testing.assert_allclose(motion.acceleration[0, 2:-2], 0, atol=1e-9)
    np.testing.assert_allclose(motion.angular_acceleration[0, 2:-2], 0, atol=1e-9)


def test_kinematics_are_unknown_beside_invalid_steps():
    valid = np.ones((1, 9), bool)
    valid[0, 4] = False
    motion = kinematics(np.zeros((1, 9, 2)), np.zeros((1, 9)), valid, 0.1)
    assert np.flatnonzero(np.isfinite(motion.speed[0])).tolist() == [1, 2, 4, 6, 7]
    assert np.flatnonzero(np.isfinite(motion.acceleration[0])).tolist() == [3, 5]


def test_road_distance_is_that_of_the_nearest_segment():
    shapely = pytest.importorskip("shapely")
    rng = np.random.default_rng(0)
    lines = [np.cumsum(rng.uniform(1, 6, (9, 3)), 0) + rng.uniform(-20, 20, 3) for _ in range(5)]
    lanes = [MapLane(f"{k}", "surface_street", line) for k, line in enumerate(lines)]
    lanes.append(MapLane("walk", "not_for_cars", np.zeros((2, 3))))
    points = rng.uniform(-30, 60, (200, 2))
    union = shapely.MultiLineString([line[:, :2] for line in lines])
    expected = [union.distance(shapely.Point(point)) for point in points]
    np.testing.assert_allclose(RoadDistance(lanes)(points), expected, atol=0.15)
    assert np.abs(RoadDistance(lanes)(points) - expected).mean() < 5e-3
    assert np.isinf(RoadDistance(lanes[-1:])(points)).all()
