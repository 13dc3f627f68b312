"""Nearest segments and places along lanes, against closed forms and scjax.scene.geometry."""

import numpy as np

from scjax.metrics.lanes import lane_arc_lengths, lane_segments, nearest_segment, points_along
from scjax.scene import geometry, pad
from tests.factories.traffic import agent, lane, scene


def test_nearest_segment_measures_to_the_segment():
    segments = np.array([[[0.0, 0, 0], [10, 0, 0]], [[10, 0, 0], [10, 10, 0]]])
    points = np.array([[5.0, 2], [-3, 4], [12, 5], [10, 12]])
    distance, heading = nearest_segment(points, segments)
    np.testing.assert_allclose(distance, [2, 5, 2, 2])
    np.testing.assert_allclose(heading, [0, 0, np.pi / 2, np.pi / 2])


def test_nearest_segment_of_empty_inputs():
    empty = np.zeros((0, 2, 3))
    assert np.isinf(nearest_segment(np.zeros((2, 2)), empty)[0]).all()
    assert nearest_segment(np.zeros((0, 2)), empty)[0].shape == (0,)


def test_nearest_segment_ignores_zero_length_headings():
    segments = np.array([[[0.0, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 3, 0]]])
    distance, heading = nearest_segment(np.array([[0.0, -1]]), segments)
    assert distance[0] == 1 and heading[0] == np.pi / 2


def test_nearest_segment_equals_scene_geometry():
    rng = np.random.default_rng(0)
    lanes = rng.normal(0, 10, (5, 20, 3)).cumsum(1).astype(np.float32) / 10
    padded_scene = scene([agent(0, 0)], list(lanes))
    points = rng.uniform(-20, 20, (30, 2)).astype(np.float32)
    expected = np.asarray(geometry.distance_to_polylines(points, lanes)).min(-1)
    np.testing.assert_allclose(nearest_segment(points, lane_segments(pad(padded_scene, 3, 9)))[0], expected, atol=1e-4)


def test_points_along_walk_lanes_in_order():
    padded_scene = pad(scene([agent(0, 0)], [lane((0, 0), (10, 0), z=2), lane((0, 5), (0, 25))]), 4, 6)
    np.testing.assert_allclose(lane_arc_lengths(padded_scene), [10, 20], rtol=1e-6)
    points, direction = points_along(lane_segments(padded_scene), np.array([0.0, 4, 12, 30]))
    np.testing.assert_allclose(points, [[0, 0, 2], [4, 0, 2], [0, 7, 0], [0, 25, 0]], atol=1e-5)
    np.testing.assert_allclose(direction, [[1, 0], [1, 0], [0, 1], [0, 1]], atol=1e-6)
