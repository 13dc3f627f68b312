"""Calibrations of others become rigs; recorded boxes land where an independent projection puts them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import scjax
from scjax.camera import (
    ElementKind,
    WireframeRenderer,
    WireframeStyle,
    project_points,
    read_calibration,
    read_nuscenes_calibration,
)
from scjax.camera.calibrations import rotation_of_quaternion
from tests.factories.camera_logs import box_log

HALF = np.sqrt(0.5)
FORWARD = (0.5, -0.5, 0.5, -0.5)  # quaternion w, x, y, z of a camera that looks along x
INTRINSIC = [[100.0, 0.0, 80.0], [0.0, 100.0, 45.0], [0.0, 0.0, 1.0]]


def nuscenes_sample(**changes) -> dict:
    camera = {
        "file": "front.jpg",
        "width": 160,
        "height": 90,
        "intrinsic": INTRINSIC,
        "sensor_to_ego": {"translation": [1.5, 0.0, 1.5], "rotation_wxyz": FORWARD},
        "ego_to_global": {"translation": [100.0, 50.0, 0.0], "rotation_wxyz": [HALF, 0.0, 0.0, HALF]},
    }
    return {"scene_id": "s", "sensors": {"FRONT": camera | changes, "LIDAR": {"file": "lidar.bin"}}}


def write(folder: Path, content, name: str = "sample.json") -> Path:
    (folder / name).write_text(json.dumps(content))
    return folder / name


def test_nuscenes_sample_is_a_rig_with_poses(tmp_path):
    calibration = read_calibration(write(tmp_path, nuscenes_sample()))
    camera = calibration.rig.camera("FRONT")
    np.testing.assert_allclose(camera.rotation[:, 2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(calibration.poses["FRONT"].rotations[0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    assert calibration.pictures == {"FRONT": "front.jpg"} and len(calibration.rig.cameras) == 1


def test_nuscenes_poses_place_the_camera(tmp_path):
    """A car 10 m ahead of the camera, on the way to +y: its rear face is 8 m away in the middle of the picture."""
    calibration = read_calibration(write(tmp_path, nuscenes_sample()))
    log = box_log((100.0, 61.5, 90.0))
    renderer = WireframeRenderer(log, calibration.rig, poses=calibration.poses["FRONT"])
    assert renderer.frame(0).rgb.any() is np.False_  # the ego, whose poses these are, is not drawn
    np.testing.assert_allclose(renderer.poses.translations[0], [100, 51.5, 1.5])


def test_nuscenes_tables_give_the_same_rig(tmp_path):
    sample = nuscenes_sample()["sensors"]["FRONT"]
    write(tmp_path, [{"token": "s1", "channel": "FRONT"}, {"token": "s2", "channel": "LIDAR"}], "sensor.json")
    mount = sample["sensor_to_ego"]
    rows = [("c1", "s1", INTRINSIC), ("c2", "s2", [])]
    content = [
        {
            "token": token,
            "sensor_token": sensor,
            "translation": mount["translation"],
            "rotation": mount["rotation_wxyz"],
            "camera_intrinsic": intrinsic,
        }
        for token, sensor, intrinsic in rows
    ]
    write(tmp_path, content, "calibrated_sensor.json")
    pose = sample["ego_to_global"]
    rotation = pose["rotation_wxyz"]
    ego = [{"token": "e1", "translation": pose["translation"], "rotation": rotation, "timestamp": 5}]
    write(tmp_path, ego, "ego_pose.json")
    data = {"sample_token": "a", "ego_pose_token": "e1", "is_key_frame": True, "filename": "front.jpg"}
    sizes = {"width": 160, "height": 90}
    rows = [data | sizes | {"calibrated_sensor_token": "c1"}, data | {"calibrated_sensor_token": "c2"}]
    write(tmp_path, [*rows, rows[0] | {"is_key_frame": False}], "sample_data.json")
    tables = read_nuscenes_calibration(tmp_path, "a")
    direct = read_calibration(write(tmp_path, nuscenes_sample()))
    for one, other in zip(tables.rig.cameras, direct.rig.cameras, strict=True):
        assert np.array_equal(one.rotation, other.rotation) and np.array_equal(one.intrinsic, other.intrinsic)
    assert np.array_equal(tables.poses["FRONT"].rotations, direct.poses["FRONT"].rotations)
    with pytest.raises(ValueError, match="no key frame of the sample 'b'"):
        read_nuscenes_calibration(tmp_path, "b")


def test_waymo_cameras_look_along_x(tmp_path):
    mount = np.eye(4)
    mount[:3, 3] = [1.5, 0.0, 2.1]
    sensor = {
        "width": 192,
        "height": 128,
        "intrinsic_fu_fv_cu_cv_k1_k2_p1_p2_k3": [200.0, 200.0, 96.0, 64.0, 0.04, -0.3, 0.0, 0.0, 0.0],
        "camera_to_vehicle_4x4": mount.ravel().tolist(),
    }
    camera = read_calibration(write(tmp_path, {"sensors": {"FRONT": sensor}})).rig.camera()
    point = (np.array([[11.5, 1.0, 2.1]]) - camera.translation) @ camera.rotation  # 10 m ahead, 1 m to the left
    pixels = project_points(camera, point).pixels[0]
    radial = 1 + 0.01 * (0.04 - 0.3 * 0.01)
    np.testing.assert_allclose(pixels, [96 - 20 * radial, 64], atol=1e-9)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"sensors": {"LIDAR": {"file": "x"}}}, "none of its sensors is a camera"),
        ({"cameras": []}, "missing required field `sensors`"),
        (nuscenes_sample(width=0), "sensors.FRONT: .*width is 0"),
        (nuscenes_sample(sensor_to_ego={"translation": [0, 0, 0], "rotation_wxyz": [0, 0, 0, 0]}), "is no rotation"),
        ({"sensors": {"F": {"intrinsic_fu_fv_cu_cv_k1_k2_p1_p2_k3": [1.0]}}}, "sensors.F: .* has 1 numbers: give nine"),
    ],
)
def test_read_calibration_names_file_and_sensor(content, message, tmp_path):
    path = write(tmp_path, content)
    with pytest.raises(ValueError, match=message) as error:
        read_calibration(path)
    assert "sample.json" in str(error.value)


def test_rotation_of_quaternion_is_a_rotation():
    rng = np.random.default_rng(0)
    for quaternion in rng.normal(size=(20, 4)).tolist():
        rotation = rotation_of_quaternion(quaternion)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation_of_quaternion([HALF, 0.0, 0.0, HALF]) @ [1, 0, 0], [0, 1, 0], atol=1e-12)


# --- a recorded moment -------------------------------------------------------------------------------------------


def hamilton(p, q):
    """The product of two quaternions w, x, y, z."""
    return np.array(
        [
            p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
            p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
            p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
            p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
        ]
    )


def turned_back(quaternion, vector):
    """The vector in the frame that a quaternion turns, by quaternion products alone."""
    q = np.array(quaternion) / np.linalg.norm(quaternion)
    inverse = q * [1, -1, -1, -1]
    return hamilton(hamilton(inverse, [0.0, *vector]), q)[1:]


def independent_pixels(sensor: dict, point: np.ndarray) -> tuple[np.ndarray, float]:
    """Pixel and depth of a point of the world, from the raw numbers of the calibration."""
    for name in ("ego_to_global", "sensor_to_ego"):
        point = turned_back(sensor[name]["rotation_wxyz"], point - np.array(sensor[name]["translation"]))
    x, y, depth = point
    (fx, _, cx), (_, fy, cy), _ = sensor["intrinsic"]
    return np.array([fx * x / depth + cx, fy * y / depth + cy]), depth


@pytest.fixture(scope="module")
def moments(data_dir):
    """Raw calibrations of recorded moments, and a renderer for each camera where it was."""
    found = []
    for path in sorted((data_dir / "nuscenes_mini").glob("images/*/calibration.json")):
        content, calibration = json.loads(path.read_text()), read_calibration(path)
        log = scjax.import_log((path.parent / content["scene_file"]).resolve())[0:1]
        style = WireframeStyle(occlusion=False, borders=False)
        for name, poses in calibration.poses.items():
            renderer = WireframeRenderer(log, calibration.rig, name, poses=poses, style=style)
            found.append((content["sensors"][name], renderer))
    if not found:
        pytest.skip("no recorded pictures with a calibration")
    return found


def test_box_centers_of_recorded_moments_agree_with_an_independent_projection(moments):
    errors = []
    for sensor, renderer in moments:
        log, camera = renderer.log, renderer.camera
        rotation, position = renderer.poses.rotations[0], renderer.poses.translations[0]
        centers = log.positions[log.valid[:, 0], 0]
        actual = project_points(camera, (centers - position) @ rotation)
        for row, center in enumerate(centers):
            expected, depth = independent_pixels(sensor, center)
            if depth > 0.2 and (expected >= 0).all() and (expected < [camera.width, camera.height]).all():
                errors.append(np.abs(actual.pixels[row] - expected).max() if actual.visible[row] else np.inf)
    assert len(errors) > 50 and max(errors) < 2


def test_boxes_of_recorded_moments_lie_around_their_centers(moments):
    """In the drawn picture the pixels of each near box surround its independently projected center."""
    checked, margin = 0, 60  # pixels; boxes at the border are cut
    for sensor, renderer in moments:
        log, camera, picture = renderer.log, renderer.camera, renderer.frame(0, buffers=True)
        assert picture.ids is not None and picture.kinds is not None
        for row in np.flatnonzero(log.valid[:, 0]).tolist():
            expected, depth = independent_pixels(sensor, log.positions[row, 0])
            rows, columns = np.nonzero((picture.ids == row) & (picture.kinds == ElementKind.BOX))
            inside = (expected > margin).all() and (expected < [camera.width - margin, camera.height - margin]).all()
            if 2 < depth < 40 and inside and len(rows) > 500:
                low, high = [columns.min(), rows.min()], [columns.max(), rows.max()]
                assert (expected >= low).all() and (expected <= high).all()
                checked += 1
    assert checked > 10
