"""Projection and clipping follow from geometry, and never fail near the plane of the camera."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scjax.camera import camera_rotation, pinhole, preset_rig, project_points, project_segments
from scjax.camera.clipping import clip_depth, clip_disc, clip_polygons, clip_rectangle
from scjax.camera.distortion import distort, max_radius, undistort
from scjax.camera.projection import FAR, MARGIN, NEAR, pixel_rays, project_faces
from tests.factories.camera_logs import level_camera

CAMERA = level_camera()
LENS = np.array([-0.356123, 0.172545, -0.00213, 0.000464, -0.05231])
BARREL = np.array([-0.3, 0.0, 0.0, 0.0, 0.0])
coordinates = st.floats(-200, 200)
points = st.tuples(coordinates, coordinates, coordinates)


def test_project_points_puts_points_where_similar_triangles_do():
    result = project_points(CAMERA, np.array([[0.0, 0.0, 10.0], [1.0, -0.5, 10.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(result.pixels[:2], [[100, 50], [110, 45]], atol=1e-12)
    assert result.visible.tolist() == [True, True, False, False]
    assert np.isfinite(result.pixels).all()


def test_preset_looks_along_its_axis():
    """The point ten meters ahead of the camera, in the frame of the rear axle, is (0, 0, 10) in that of the camera."""
    camera = preset_rig("nuplan-front-a").camera()
    ahead = camera.translation + 10 * camera.rotation[:, 2]
    np.testing.assert_allclose((ahead - camera.translation) @ camera.rotation, [0, 0, 10], atol=2e-4)
    assert camera.rotation[2, 2] < 0  # it looks down


def test_camera_rotation_turns_left_and_up():
    assert camera_rotation()[:, 2].tolist() == [1, 0, 0]
    np.testing.assert_allclose(camera_rotation(yaw=90.0)[:, 2], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(camera_rotation(pitch=30.0)[:, 2], [np.sqrt(0.75), 0, 0.5], atol=1e-12)
    np.testing.assert_allclose(camera_rotation(roll=90.0)[:, 0], [0, 0, -1], atol=1e-12)  # right goes down


def test_fitted_camera_keeps_the_centers_of_pixels():
    camera = preset_rig("nuplan-front-a").camera().fitted(1280, 704)
    np.testing.assert_allclose(
        camera.intrinsic[[0, 1, 0, 1], [0, 1, 2, 2]], [1030, 1030, 639.8333, 365.1667], atol=1e-3
    )


def test_resized_camera_sees_the_same():
    camera = preset_rig("nuplan-front-b").camera()
    point = np.array([[2.0, 1.0, 9.0]])
    before, after = project_points(camera, point).pixels, project_points(camera.resized(640, 360), point).pixels
    np.testing.assert_allclose(after, (before + 0.5) / 3 - 0.5)


def test_field_of_view_is_that_of_the_calibration():
    assert preset_rig("nuplan-front-a").camera().field_of_view[0] == pytest.approx(63.7, abs=0.05)
    assert pinhole("c", 100, 100, field_of_view=90.0).field_of_view == pytest.approx((90.0, 90.0))


# --- lenses ------------------------------------------------------------------------------------------------------


@given(st.floats(-0.6, 0.6), st.floats(-0.35, 0.35))
def test_undistort_inverts_distort(x, y):
    point = np.array([[x, y]])
    np.testing.assert_allclose(undistort(distort(point, LENS), LENS), point, atol=1e-8)


def test_max_radius_is_where_the_radial_part_turns():
    assert max_radius(BARREL) == pytest.approx(1 / np.sqrt(0.9))
    assert np.isinf(max_radius(np.array([0.1, 0.0, 0.0, 0.0, 0.0])))
    radius = np.linspace(0, max_radius(LENS), 1000)
    assert (np.diff(distort(np.column_stack([radius, 0 * radius]), LENS * [1, 1, 0, 0, 1])[:, 0]) > 0).all()


def test_points_beyond_the_fold_are_rejected():
    camera = dataclasses.replace(CAMERA, distortion=BARREL)
    beyond = np.array([[1.2 * max_radius(BARREL), 0.0, 1.0]])
    assert (distort(beyond[:, :2], BARREL)[:, 0] < 1).all()  # it would fold back into the picture
    assert not project_points(camera, beyond).visible.any()


def test_segments_bend_behind_a_lens():
    """The pieces of a long segment follow its distorted points, and stop at the fold."""
    camera = dataclasses.replace(level_camera(size=(400, 200)), distortion=BARREL)
    first, second = np.array([[-3.0, 0.3, 1.0]]), np.array([[3.0, 0.3, 1.0]])
    pieces = project_segments(camera, first, second)
    assert len(pieces.rows) > 3
    np.testing.assert_allclose(pieces.ends[1:, 0], pieces.ends[:-1, 1])
    share = np.linspace(0, 1, 2001)[:, None]
    dense = project_points(camera, first + share * (second - first))
    pixels = dense.pixels[dense.visible]
    assert distance_to(pieces.ends, pixels).max() < 1.0
    corners = pieces.ends.reshape(-1, 2)[1:-1]  # samples at the fold are far apart
    assert distance_to(np.stack([pixels[:-1], pixels[1:]], 1), corners).max() < 0.01


def test_pixel_rays_invert_the_projection():
    camera = dataclasses.replace(preset_rig("nuplan-front-a-raw").camera())
    ideal = np.array([[0.2, 0.1], [-0.4, 0.2], [0.0, 0.0]])
    pixels = project_points(camera, np.column_stack([5 * ideal, np.full(3, 5.0)])).pixels
    np.testing.assert_allclose(pixel_rays(camera, pixels), ideal, atol=1e-9)


# --- clipping ----------------------------------------------------------------------------------------------------


def distance_to(segments: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Distance of each place to the nearest of the segments."""
    along = segments[:, 1] - segments[:, 0]
    offset = places[:, None] - segments[None, :, 0]
    share = (offset * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-12)
    return np.linalg.norm(offset - share.clip(0, 1)[..., None] * along, axis=-1).min(1)


def test_segment_through_the_camera_plane_ends_on_the_near_plane():
    parts = project_segments(CAMERA, np.array([[0.0, 1.0, -5.0]]), np.array([[0.0, 1.0, 5.0]]))
    assert 1 / parts.inverse_depths[0, 1] == pytest.approx(5.0)
    part = clip_depth(np.array([-5.0]), np.array([5.0]), NEAR, FAR)
    assert -5 + 10 * part.start[0] == pytest.approx(NEAR)


def test_segments_behind_the_camera_or_beyond_the_far_plane_are_gone():
    first = np.array([[0.0, 0.0, -5.0], [0.0, 0.0, 90.0], [0.0, 0.0, 0.1]])
    assert not len(project_segments(CAMERA, first, first + np.array([0.1, 0.0, 0.05])).rows)


def test_segment_in_the_camera_plane_is_gone():
    assert not len(project_segments(CAMERA, np.array([[-1.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]])).rows)


@pytest.mark.parametrize("distortion", [np.zeros(5), LENS])
@given(points, points)
def test_segments_are_finite_and_near_the_picture(distortion, first, second):
    camera = dataclasses.replace(CAMERA, distortion=distortion)
    parts = project_segments(camera, np.array([first]), np.array([second]))
    assert np.isfinite(parts.ends).all() and np.isfinite(parts.inverse_depths).all()
    low, high = -MARGIN - 1e-6, np.array([camera.width, camera.height]) - 1 + MARGIN + 1e-6
    assert (parts.ends >= low).all() and (parts.ends <= high).all()
    assert (parts.inverse_depths >= 1 / FAR - 1e-9).all() and (parts.inverse_depths <= 1 / NEAR + 1e-9).all()


@given(points, points)
def test_clipped_segment_is_what_dense_samples_show(first, second):
    """Samples inside the view lie on the clipped segment; without samples there is at most a short one."""
    start, stop = np.array([first]), np.array([second])
    share = np.linspace(0, 1, 4001)[:, None]
    samples = start + share * (stop - start)
    result = project_points(CAMERA, samples)
    high = np.array([CAMERA.width, CAMERA.height]) - 1 + MARGIN
    inside = result.visible & (result.depth <= FAR) & ((result.pixels >= -MARGIN) & (result.pixels <= high)).all(-1)
    parts = project_segments(CAMERA, start, stop)
    if inside.any():
        pixels, depth = result.pixels[inside], result.depth[inside]
        assert len(parts.rows) == 1
        assert distance_to(parts.ends, pixels).max() < 1e-6
        span = 1 / parts.inverse_depths[0]
        assert depth.min() >= span.min() - 1e-6 and depth.max() <= span.max() + 1e-6
        # The ends are at most a sample's step outside of what the samples show.
        step = np.linalg.norm(stop - start) / 4000
        assert depth.min() <= span.min() + step + 1e-6 and depth.max() >= span.max() - step - 1e-6


def test_clip_rectangle_cuts_at_the_border():
    part = clip_rectangle(
        np.array([[-1.0, 0.5], [2.0, 2.0]]), np.array([[3.0, 0.5], [3.0, 3.0]]), (0.0, 0.0), (1.0, 1.0)
    )
    assert (part.start[0], part.stop[0]) == (0.25, 0.5) and part.keep.tolist() == [True, False]


def test_clip_disc_cuts_at_the_circle():
    first, second = np.array([[-2.0, 0.0], [0.5, 0.0], [2.0, 2.0]]), np.array([[2.0, 0.0], [0.5, 0.0], [3.0, 2.0]])
    part = clip_disc(first, second, 1.0)
    np.testing.assert_allclose([part.start[0], part.stop[0]], [0.25, 0.75])
    assert part.keep.tolist() == [True, True, False]  # a point inside stays


def test_clip_polygons_keeps_the_part_above():
    square = np.array([[[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]])
    above = clip_polygons(square, np.array([0.0, 1.0]), 0.5)
    assert above.shape == (1, 5, 2)
    assert {tuple(corner) for corner in above[0].tolist()} == {(0.0, 0.5), (2.0, 0.5), (2.0, 2.0), (0.0, 2.0)}
    corner = clip_polygons(square, np.array([-1.0, -1.0]), -3.0)  # five corners
    assert len({tuple(point) for point in corner[0].tolist()}) == 5
    assert np.isnan(clip_polygons(square, np.array([1.0, 0.0]), 5.0)).all()


def test_clip_polygons_keeps_repeated_corners_and_nan():
    flat = np.array([[[1.0, 1.0]] * 4, [[np.nan, np.nan]] * 4])
    result = clip_polygons(flat, np.array([1.0, 0.0]), 0.0)
    assert (result[0] == 1.0).all() and np.isnan(result[1]).all()


def test_face_around_the_camera_fills_the_picture():
    """A floor below the camera goes through its plane and reaches both lower corners."""
    floor = np.array([[[-50.0, 1.0, -50.0], [50.0, 1.0, -50.0], [50.0, 1.0, 50.0], [-50.0, 1.0, 50.0]]])
    corners = project_faces(CAMERA, floor)[0]
    assert np.isfinite(corners).all()
    assert corners[:, 0].min() == -MARGIN and corners[:, 0].max() == CAMERA.width - 1 + MARGIN
    assert corners[:, 1].min() == pytest.approx(50 + 100 / 50) and corners[:, 1].max() == CAMERA.height - 1 + MARGIN


# --- cameras at fault --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": ""}, "empty name"),
        ({"width": 0}, "width is 0"),
        ({"height": 99999}, "height is 99999"),
        ({"intrinsic": np.eye(3) * 2}, "intrinsic is"),
        ({"intrinsic": np.diag([-5.0, 5.0, 1.0])}, "fx, fy > 0"),
        ({"rotation": 2 * np.eye(3)}, "no right-handed axes"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "no right-handed axes"),
        ({"translation": np.array([0.0, np.nan, 0.0])}, "translation must be finite"),
    ],
)
def test_camera_names_the_field_at_fault(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(CAMERA, **change)


def test_pinhole_refuses_angles_that_no_pinhole_has():
    with pytest.raises(ValueError, match="field_of_view is 180"):
        pinhole("c", 10, 10, field_of_view=180.0)
