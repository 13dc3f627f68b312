"""Calibrations of recorded pictures: one moment of nuScenes or Waymo as a rig, and the poses of the car.

Each picture of a moment is taken at its own time, so the car has a pose for each camera.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from msgspec import Struct

from scjax.camera.camera import Camera
from scjax.camera.distortion import NO_DISTORTION
from scjax.camera.rig import CameraPoses, Rig
from scjax.camera.rig_file import RIG_FORMAT, RigHeader, Triple, parse_rig
from scjax.scene.document import parse_document
from scjax.scene.files import read_limited

Quaternion = tuple[float, float, float, float]
_CURE = "give the calibration of one sample, as docs/camera.md shows"
_TABLES_CURE = "give the folder with the tables of nuScenes, as in v1.0-mini"
_WAYMO_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # its cameras look along x, z is up


@dataclasses.dataclass(frozen=True, eq=False)
class CameraCalibration:
    """The cameras of one moment.

    Attributes:
      rig: with the frame of the car as its frame.
      poses: name of a camera -> pose of the car in the world when its picture was taken, of one step. Empty for a rig
        without a moment.
      pictures: name of a camera -> file of its picture as the source names it.
    """

    rig: Rig
    poses: dict[str, CameraPoses] = dataclasses.field(default_factory=dict)
    pictures: dict[str, str] = dataclasses.field(default_factory=dict)


class PoseDocument(Struct):
    """A pose as nuScenes writes it: position [m] and rotation as a quaternion w, x, y, z."""

    translation: Triple
    rotation_wxyz: Quaternion


class SensorDocument(Struct):
    """A sensor of a sample. Cameras have an intrinsic matrix, or nine numbers as in Waymo; other sensors have none."""

    file: str = ""
    width: int = 0
    height: int = 0
    intrinsic: tuple[Triple, Triple, Triple] | None = None
    sensor_to_ego: PoseDocument | None = None
    ego_to_global: PoseDocument | None = None
    intrinsic_fu_fv_cu_cv_k1_k2_p1_p2_k3: list[float] | None = None
    camera_to_vehicle_4x4: list[float] | None = None
    image_pose_vehicle_to_world_4x4: list[float] | None = None


class SampleDocument(Struct):
    """The sensors of one moment."""

    sensors: dict[str, SensorDocument]
    scene_id: str = ""


class SensorRow(Struct):
    """A row of sensor.json."""

    token: str
    channel: str
    modality: str = "camera"


class CalibratedSensorRow(Struct):
    """A row of calibrated_sensor.json."""

    token: str
    sensor_token: str
    translation: Triple
    rotation: Quaternion
    camera_intrinsic: list[Triple]


class EgoPoseRow(Struct):
    """A row of ego_pose.json."""

    token: str
    translation: Triple
    rotation: Quaternion


class SampleDataRow(Struct):
    """A row of sample_data.json."""

    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    is_key_frame: bool
    filename: str = ""
    width: int = 0
    height: int = 0


def read_calibration(path: str | Path) -> CameraCalibration:
    """The cameras in a JSON file: a rig of scjax, or a sample of nuScenes or Waymo with its ``sensors``.

    Raises:
      FileNotFoundError: there is no such file.
      ValueError: naming the file and what is wrong with it.
    """
    data = read_limited(path)
    if parse_document(data, RigHeader, path, _CURE).format == RIG_FORMAT:
        return CameraCalibration(parse_rig(data, path))
    sample = parse_document(data, SampleDocument, path, _CURE)
    cameras, poses, pictures = [], {}, {}
    for name, sensor in sample.sensors.items():
        try:
            if sensor.intrinsic is not None and sensor.sensor_to_ego is not None:
                cameras.append(_nuscenes_camera(name, sensor, sensor.intrinsic, sensor.sensor_to_ego))
                if sensor.ego_to_global is not None:
                    pose = sensor.ego_to_global
                    poses[name] = _pose(pose.rotation_wxyz, pose.translation)
            elif sensor.intrinsic_fu_fv_cu_cv_k1_k2_p1_p2_k3 is not None:
                cameras.append(_waymo_camera(name, sensor))
                if sensor.image_pose_vehicle_to_world_4x4 is not None:
                    matrix = _matrix(sensor.image_pose_vehicle_to_world_4x4, "image_pose_vehicle_to_world_4x4")
                    poses[name] = CameraPoses(matrix[None, :3, :3], matrix[None, :3, 3])
            else:
                continue
        except ValueError as error:
            raise ValueError(f"{path}: sensors.{name}: {error}") from error
        pictures[name] = sensor.file
    if not cameras:
        raise ValueError(f"{path}: none of its sensors is a camera with an intrinsic matrix: {_CURE}")
    return CameraCalibration(Rig(name=sample.scene_id or "sample", cameras=tuple(cameras)), poses, pictures)


def read_nuscenes_calibration(folder: str | Path, sample_token: str) -> CameraCalibration:
    """The cameras of a sample, from the tables of nuScenes that a user has.

    Args:
      folder: with sensor.json, calibrated_sensor.json, ego_pose.json and sample_data.json.
      sample_token: of the sample.

    Raises:
      FileNotFoundError: a table is missing.
      ValueError: naming the table and what is wrong with it, or the sample that is not there.
    """
    folder = Path(folder)

    def table(name: str, row: Any) -> list[Any]:
        path = folder / f"{name}.json"
        return parse_document(read_limited(path), list[row], path, _TABLES_CURE)

    rows = [row for row in table("sample_data", SampleDataRow) if row.is_key_frame and row.sample_token == sample_token]
    if not rows:
        raise ValueError(
            f"{folder / 'sample_data.json'} has no key frame of the sample {sample_token!r}: give its token"
        )
    sensors = {row.token: row for row in table("sensor", SensorRow)}
    calibrated = {row.token: row for row in table("calibrated_sensor", CalibratedSensorRow)}
    ego_poses = {row.token: row for row in table("ego_pose", EgoPoseRow)}
    cameras, poses, pictures = [], {}, {}
    for row in rows:
        try:
            sensor = calibrated[row.calibrated_sensor_token]
            name, ego = sensors[sensor.sensor_token].channel, ego_poses[row.ego_pose_token]
        except KeyError as error:
            raise ValueError(f"{folder}: the tables lack the token {error}: {_TABLES_CURE}") from error
        if len(sensor.camera_intrinsic) != 3:  # radar and lidar have none
            continue
        document = SensorDocument(width=row.width, height=row.height)
        mount = PoseDocument(sensor.translation, sensor.rotation)
        first, second, third = sensor.camera_intrinsic
        try:
            cameras.append(_nuscenes_camera(name, document, (first, second, third), mount))
            poses[name] = _pose(ego.rotation, ego.translation)
        except ValueError as error:
            raise ValueError(f"{folder}: {error}") from error
        pictures[name] = row.filename
    if not cameras:
        raise ValueError(f"{folder}: the sample {sample_token!r} has no pictures: give another")
    return CameraCalibration(Rig(name=sample_token, cameras=tuple(cameras)), poses, pictures)


def rotation_of_quaternion(quaternion: Quaternion | list[float]) -> Float64[np.ndarray, "3 3"]:
    """The rotation of a quaternion w, x, y, z of any length but 0, in float64; ValueError for none."""
    values = np.array(quaternion, np.float64)
    length = float(np.linalg.norm(values))
    if not np.isfinite(length) or length < 1e-6:
        raise ValueError(f"the quaternion {values.tolist()} is no rotation: give w, x, y, z")
    w, x, y, z = (values / length).tolist()
    vector = np.array([x, y, z])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (w * w - vector @ vector) * np.eye(3) + 2 * np.outer(vector, vector) + 2 * w * cross


def _pose(quaternion: Quaternion, translation: Triple) -> CameraPoses:
    return CameraPoses(rotation_of_quaternion(quaternion)[None], np.array(translation, np.float64)[None])


def _nuscenes_camera(
    name: str, sensor: SensorDocument, intrinsic: tuple[Triple, Triple, Triple], mount: PoseDocument
) -> Camera:
    return Camera(
        name=name,
        width=sensor.width,
        height=sensor.height,
        intrinsic=np.array(intrinsic, np.float64),
        rotation=rotation_of_quaternion(mount.rotation_wxyz),
        translation=np.array(mount.translation, np.float64),
        distortion=np.array(NO_DISTORTION),  # its pictures are published without distortion
    )


def _waymo_camera(name: str, sensor: SensorDocument) -> Camera:
    numbers = sensor.intrinsic_fu_fv_cu_cv_k1_k2_p1_p2_k3 or []
    if len(numbers) != 9:
        raise ValueError(f"intrinsic_fu_fv_cu_cv_k1_k2_p1_p2_k3 has {len(numbers)} numbers: give nine")
    fu, fv, cu, cv, *distortion = numbers
    mount = _matrix(sensor.camera_to_vehicle_4x4 or [], "camera_to_vehicle_4x4")
    return Camera(
        name=name,
        width=sensor.width,
        height=sensor.height,
        intrinsic=np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]]),
        rotation=mount[:3, :3] @ _WAYMO_AXES,
        translation=mount[:3, 3].copy(),
        distortion=np.array(distortion),
    )


def _matrix(numbers: list[float], name: str) -> np.ndarray:
    if len(numbers) != 16:
        raise ValueError(f"{name} has {len(numbers)} numbers: give the 16 of a matrix, row by row")
    return np.array(numbers, np.float64).reshape(4, 4)
