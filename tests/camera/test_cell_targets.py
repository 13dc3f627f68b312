"""Targets of the cells of a rendered picture."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.camera.dashcam import DashcamFrame, SemanticClass
from scjax.camera.dashcam.cell_targets import MAX_DEPTH, cell_targets
from scjax.scene import empty

HEIGHT = WIDTH = 8
FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # columns: right, down, ahead
POSITION = np.array([0.0, 0.0, 2.0])


def picture():
    """Sky above, road below, and an object in the lower left quarter's first cell."""
    classes = np.full((HEIGHT, WIDTH), SemanticClass.SKY, np.uint8)
    classes[4:] = SemanticClass.ROAD
    depth = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    depth[4:] = 10.0
    ids = np.full((HEIGHT, WIDTH), -1, np.int32)
    ids[4:6, :2], classes[4:6, :2] = 1, SemanticClass.VEHICLE
    return DashcamFrame(np.zeros((HEIGHT, WIDTH, 3), np.uint8), depth, classes, ids)


def one_lane():
    """A lane along x, 1 m to the left."""
    scene = empty(1, 1)
    scene.agent_mask[:], scene.lane_mask[:] = True, True
    scene.lanes[0, :, 0] = np.linspace(0, 64, scene.lanes.shape[1])
    scene.lanes[0, :, 1] = 1.0
    return scene


@pytest.fixture(scope="module")
def targets():
    rays = np.zeros((HEIGHT, WIDTH, 2))
    rays[..., 0] = np.linspace(-0.4, 0.4, WIDTH)
    boxes = np.array([[5.0, 0, 1, 0, 4, 2], [12.0, 3, 0, 1, 4.5, 1.8]])
    return cell_targets(picture(), rays, (FORWARD, POSITION), boxes, one_lane(), (4, 4))


def test_cell_targets_count_classes(targets):
    assert targets.classes.shape == (4, 4, len(SemanticClass))
    assert targets.classes[0, 0, SemanticClass.SKY] == 255
    assert targets.classes[2, 0, SemanticClass.VEHICLE] == 255
    assert targets.classes[3, 3, SemanticClass.ROAD] == 255


def test_cell_targets_give_depth_and_the_object_that_covers_most(targets):
    assert targets.depth[0, 0] == MAX_DEPTH and targets.depth[3, 3] == pytest.approx(10.0)
    np.testing.assert_allclose(targets.objects[2, 0], [12.0, 3, 0, 1, 4.5, 1.8, 1], atol=0.01)
    assert not targets.objects[3, 3].any()


def test_cell_targets_give_the_lane_beside_the_road(targets):
    """Pixels 10 m ahead see places across the road: x is 10, y falls from 4 to -4."""
    assert not targets.lanes[0].any() and not targets.lanes[2, 0].any()
    x, y, cos, sin, left, there = targets.lanes[3, 2].tolist()
    middle = -10 * np.linspace(-0.4, 0.4, WIDTH)[4:6].mean()
    assert (x, y, cos, sin, there) == pytest.approx((10.0, 1.0, 1.0, 0.0, 1.0), abs=0.01)
    assert left == pytest.approx(middle - 1.0, abs=0.01)
