"""Rigs ride on any agent, and their files are read whole or refused with the field at fault."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from scjax.camera import CAMERA_PRESETS, Rig, WireframeRenderer, preset_rig, read_calibration, read_rig, write_rig
from scjax.camera.rig import mounted_poses
from tests.factories.camera_logs import box_log, level_rig

DASHCAM = preset_rig("dashcam")


@pytest.mark.parametrize("name", CAMERA_PRESETS)
def test_presets_survive_their_files(name, tmp_path):
    rig = preset_rig(name)
    write_rig(rig, tmp_path / "rig.json")
    again = read_rig(tmp_path / "rig.json")
    assert (again.name, len(again.cameras)) == (rig.name, len(rig.cameras))
    for before, after in zip(rig.cameras, again.cameras, strict=True):
        for field in dataclasses.fields(before):
            assert np.array_equal(getattr(before, field.name), getattr(after, field.name)), field.name
    assert np.array_equal(rig.origin, again.origin) and np.array_equal(rig.carrier_size, again.carrier_size)


def test_mount_is_behind_the_windscreen_of_its_own_car():
    """The rear axle is 1.46 m behind the middle of the box, and the camera 1.66 m ahead of the axle."""
    poses = mounted_poses(DASHCAM, DASHCAM.camera(), np.zeros((1, 3)), np.zeros(1), DASHCAM.carrier_size)
    np.testing.assert_allclose(poses.translations[0], [0.2, 0.0, 1.53], atol=1e-12)


def test_mount_scales_with_its_carrier():
    size = DASHCAM.carrier_size
    small = mounted_poses(DASHCAM, DASHCAM.camera(), np.zeros((1, 3)), np.zeros(1), size)
    large = mounted_poses(DASHCAM, DASHCAM.camera(), np.zeros((1, 3)), np.zeros(1), size * [2, 1, 3])
    np.testing.assert_allclose(large.translations, small.translations * [2, 1, 3])
    assert np.array_equal(large.rotations, small.rotations)


def test_mount_turns_with_its_carrier():
    rig = preset_rig("surround-7")
    left = rig.camera("camera_cross_left_120fov")
    ground, headings = np.array([[5.0, -2.0, 1.0]]), np.array([np.pi / 2])
    poses = mounted_poses(rig, left, ground, headings, rig.carrier_size)
    x, y, z = rig.origin + left.translation
    np.testing.assert_allclose(poses.translations[0], [5 - y, -2 + x, 1 + z])
    assert poses.rotations[0, 0, 2] < -0.9  # it looks to -x, the left of a car that drives to +y


def test_camera_rides_on_any_actor():
    log = box_log((0, 0, 0), (20, 5, 180))
    poses = WireframeRenderer(log, level_rig(), actor=1).poses
    np.testing.assert_allclose(poses.translations[0], [20, 5, 1])
    np.testing.assert_allclose(poses.rotations[0, :, 2], [-1, 0, 0], atol=1e-12)


def test_camera_of_a_carrier_without_height_stands_on_the_lanes():
    log = box_log((0, 0, 0))
    log.positions[0, 0, 2] = np.nan
    assert WireframeRenderer(log, level_rig()).poses.translations[0, 2] == 1.0


def test_rig_names_the_cameras_that_it_has():
    rig = preset_rig("surround-6")
    with pytest.raises(ValueError, match=r"has 6 cameras: name one of CAM_FRONT"):
        rig.camera()
    with pytest.raises(ValueError, match="has no camera 'top'"):
        rig.select("CAM_BACK", "top")
    assert [camera.name for camera in rig.select("CAM_BACK").cameras] == ["CAM_BACK"]


def test_unknown_preset_lists_the_known_ones():
    with pytest.raises(ValueError, match="no camera preset 'gopro': choose from dashcam, nuplan-front-a"):
        preset_rig("gopro")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cameras": ()}, "has no cameras"),
        ({"cameras": DASHCAM.cameras * 2}, r"\['front', 'front'\] repeat"),
        ({"origin": np.full(3, np.inf)}, "origin must be three finite numbers"),
        ({"carrier_size": np.zeros(3)}, "carrier_size must be three lengths"),
    ],
)
def test_rig_names_the_field_at_fault(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(DASHCAM, **change)


def document(**changes) -> dict:
    camera = {
        "name": "front",
        "width": 64,
        "height": 32,
        "intrinsic": [[50.0, 0.0, 32.0], [0.0, 50.0, 16.0], [0.0, 0.0, 1.0]],
        "rotation": [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
        "translation": [1.5, 0.0, 1.4],
    }
    return {"format": "scjax-rig", "version": 1, "cameras": [camera | changes]}


def test_rig_written_by_hand_needs_cameras_only(tmp_path):
    (tmp_path / "rig.json").write_text(json.dumps(document()))
    rig = read_rig(tmp_path / "rig.json")
    assert isinstance(rig, Rig) and not rig.camera().is_distorted and rig.carrier_size is None
    assert len(read_calibration(tmp_path / "rig.json").rig.cameras) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is no JSON"),
        ("[]", "expected `object`"),
        (json.dumps({"format": "scjax-scene"}), "is no rig of cameras"),
        (json.dumps(document() | {"version": 9}), "version 9"),
        (json.dumps({"format": "scjax-rig", "version": 1}), "missing required field `cameras`"),
        (json.dumps(document(width="wide")), r"cameras\[0\]\.width"),
        (json.dumps(document(rotation=[[1.0, 0.0, 0.0]] * 3)), "no right-handed axes"),
        (json.dumps(document(lens="wide")), "unknown field `lens`"),
        (json.dumps(document()).replace("1.5", "NaN"), "translation must be finite"),
    ],
)
def test_read_rig_names_file_and_field(content, message, tmp_path):
    (tmp_path / "rig.json").write_text(content)
    with pytest.raises(ValueError, match=message) as error:
        read_rig(tmp_path / "rig.json")
    assert "rig.json" in str(error.value)
