"""Standard views: places of the ground are where the standard camera sees them, whatever camera took the picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.camera.camera import Camera, pinhole
from scjax.camera.photo import BACKGROUND, photo_from_array
from scjax.camera.projection import project_points
from scjax.camera.standard_view import (
    STANDARD_AHEAD,
    STANDARD_HEIGHT,
    STANDARD_SIZE,
    assumed_camera,
    standard_camera,
    standard_view,
)
from tests.factories.image_folders import picture

LENS = np.array([-0.2, 0.05, 0.001, -0.001, 0.0])
CAMERAS = {
    "level": pinhole("a", 448, 224, position=(STANDARD_AHEAD, 0.0, STANDARD_HEIGHT)),
    "long lens": pinhole("b", 640, 480, field_of_view=40.0, position=(STANDARD_AHEAD, 0.0, 1.3)),
    "high, down": pinhole("c", 400, 300, field_of_view=90.0, position=(STANDARD_AHEAD, 0.0, 2.2), pitch=-6.0),
    "turned": pinhole("d", 400, 300, position=(STANDARD_AHEAD, 0.0, 1.1), yaw=8.0, pitch=2.0, roll=-3.0),
    "lens": dataclasses.replace(
        pinhole("e", 400, 300, field_of_view=80.0, position=(STANDARD_AHEAD, 0.0, 1.5)), distortion=LENS
    ),
}
PLACES = np.array([[12.0, 0.0, 0.0], [18.0, 3.0, 0.0], [25.0, -4.0, 0.0], [8.0, -1.5, 0.0]])


def pixels_of(camera: Camera, places):
    return project_points(camera, (places - camera.translation) @ camera.rotation).pixels


def dot(camera: Camera, place):
    """A dark picture with a bright dot where the camera sees a place."""
    x, y = pixels_of(camera, place[None])[0]
    rows, columns = np.indices((camera.height, camera.width))
    bright = 255 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 40)
    return photo_from_array(np.repeat(bright.astype(np.uint8)[..., None], 3, 2))


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("place", PLACES, ids=str)
def test_places_of_the_ground_are_where_the_standard_camera_sees_them(name, place):
    camera = CAMERAS[name]
    view = standard_view(dot(camera, place), camera).pixels.astype(np.float64)[..., 0]
    rows, columns = np.indices(view.shape)
    weight = np.where(view > 1.2 * BACKGROUND[0], view, 0)
    found = np.array([(columns * weight).sum(), (rows * weight).sum()]) / weight.sum()
    np.testing.assert_allclose(found, pixels_of(standard_camera(), place[None])[0], atol=0.7)


def test_its_own_picture_stays():
    pixels = picture(*STANDARD_SIZE[::-1])
    np.testing.assert_array_equal(standard_view(photo_from_array(pixels), standard_camera()).pixels, pixels)


def test_the_dashcam_is_assumed():
    pixels = picture(176, 320)
    photo = photo_from_array(pixels)
    view = standard_view(photo)
    np.testing.assert_array_equal(view.pixels, standard_view(photo, assumed_camera((176, 320))).pixels)
    assert view.pixels.shape == (224, 224, 3) and (view.pixels == BACKGROUND).all(-1).mean() < 0.02
    horizon = pixels_of(assumed_camera((224, 224)), np.array([[1e6, 0.0, 0.0]]))[0]
    np.testing.assert_allclose(horizon, pixels_of(standard_camera(), np.array([[1e6, 0.0, 0.0]]))[0], atol=0.01)


def test_what_the_picture_does_not_show_is_background():
    camera = CAMERAS["long lens"]
    view = standard_view(photo_from_array(np.full((480, 640, 3), 255, np.uint8)), camera).pixels
    assert (view[100, 112] == 255).all() and (view[100, [0, -1]] == BACKGROUND).all()


def test_views_of_other_cameras_have_other_names():
    photo = photo_from_array(picture(30, 40))
    names = {standard_view(photo, camera.resized(40, 30)).content for camera in CAMERAS.values()}
    assert len(names) == len(CAMERAS) and photo.content not in names
