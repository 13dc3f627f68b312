"""Rigs by name. Positions and angles of the approximations are typical ones, of no single car."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from scjax.camera.camera import Camera, pinhole
from scjax.camera.rig import Rig

_PACIFICA = np.array([5.176, 2.297, 1.777])  # m, the car of nuPlan
_CAR = np.array([4.8, 2.1, 1.65])  # m, of usual size
_REAR_AXLE = np.array([-1.461, 0.0, 0.35])  # m; the middle of its box is 1.461 m ahead of the axle
_NUPLAN_LENS = np.array([-0.356123, 0.172545, -0.00213, 0.000464, -0.05231])
_NUPLAN_A = (
    [[-0.00786, -0.02272, 0.99971], [-0.99994, 0.00746, -0.00769], [-0.00728, -0.99971, -0.02278]],
    [1.655, -0.0117, 1.491],
)
_NUPLAN_B = (
    [[-0.00396, -0.03969, 0.99920], [-0.99971, -0.02337, -0.00489], [0.02354, -0.99894, -0.03959]],
    [1.6643, -0.0013, 1.5719],
)
"""Rotations and positions of the front camera of two cars in the frame of the rear axle, rounded."""


def _nuplan_front(mount: tuple[list[list[float]], list[float]], *, raw: bool) -> Rig:
    camera = dataclasses.replace(
        pinhole("front", 1920, 1080, focal_length=1545.0, center=(960.0, 560.0)),
        rotation=np.array(mount[0]),
        translation=np.array(mount[1]),
    )
    if raw:
        camera = dataclasses.replace(camera, distortion=_NUPLAN_LENS)
    return Rig(name="nuplan-front", cameras=(camera,), origin=_REAR_AXLE, carrier_size=_PACIFICA)


def _waymo_front() -> Rig:
    camera = pinhole("front", 1920, 1280, focal_length=2060.0, position=(1.5, 0.0, 2.1))
    return Rig(
        name="waymo-front",
        cameras=(camera,),
        origin=np.array([-1.4, 0.0, 0.0]),
        carrier_size=np.array([5.29, 2.33, 2.1]),
    )


def _dashcam() -> Rig:
    camera = pinhole("front", 1280, 704, focal_length=1030.0, position=(1.66, 0.0, 1.53), pitch=-1.5)
    return Rig(
        name="dashcam",
        cameras=(camera,),
        origin=np.array([-1.46, 0.0, 0.0]),
        carrier_size=_CAR,
    )


def _surround(name: str, size: tuple[int, int], views: dict[str, tuple[float, float, float, float, float]]) -> Rig:
    """A rig of views: name -> angle of view [degrees], x, y, z of the camera [m], yaw [degrees]."""
    cameras: list[Camera] = [
        pinhole(view, *size, field_of_view=angle, position=(x, y, z), yaw=yaw)
        for view, (angle, x, y, z, yaw) in views.items()
    ]
    return Rig(
        name=name, cameras=tuple(cameras), origin=np.array([-1.4, 0.0, 0.0]), carrier_size=np.array([4.9, 2.1, 1.6])
    )


_SEVEN = {
    "camera_front_wide_120fov": (120.0, 1.75, 0.0, 1.45, 0.0),
    "camera_front_tele_30fov": (30.0, 1.75, 0.0, 1.45, 0.0),
    "camera_cross_left_120fov": (120.0, 2.2, 0.95, 0.95, 70.0),
    "camera_cross_right_120fov": (120.0, 2.2, -0.95, 0.95, -70.0),
    "camera_rear_left_70fov": (70.0, 2.1, 1.0, 0.95, 150.0),
    "camera_rear_right_70fov": (70.0, 2.1, -1.0, 0.95, -150.0),
    "camera_rear_tele_30fov": (30.0, -0.4, 0.0, 1.4, 180.0),
}
"""Names that photoreal renderers (Cosmos-Transfer) expect. Their lenses are fisheyes, these are pinholes."""

_SIX = {
    "CAM_FRONT": (65.0, 1.7, 0.0, 1.5, 0.0),
    "CAM_FRONT_LEFT": (65.0, 1.5, 0.5, 1.5, 55.0),
    "CAM_FRONT_RIGHT": (65.0, 1.5, -0.5, 1.5, -55.0),
    "CAM_BACK": (90.0, 0.0, 0.0, 1.6, 180.0),
    "CAM_BACK_LEFT": (65.0, 1.0, 0.5, 1.6, 110.0),
    "CAM_BACK_RIGHT": (65.0, 1.0, -0.5, 1.6, -110.0),
}

CAMERA_PRESETS: dict[str, Callable[[], Rig]] = {
    "dashcam": _dashcam,
    "nuplan-front-a": lambda: _nuplan_front(_NUPLAN_A, raw=False),
    "nuplan-front-b": lambda: _nuplan_front(_NUPLAN_B, raw=False),
    "nuplan-front-a-raw": lambda: _nuplan_front(_NUPLAN_A, raw=True),
    "nuplan-front-b-raw": lambda: _nuplan_front(_NUPLAN_B, raw=True),
    "waymo-front": _waymo_front,
    "surround-6": lambda: _surround("surround-6", (1600, 900), _SIX),
    "surround-7": lambda: _surround("surround-7", (1280, 704), _SEVEN),
}
"""Name -> rig. The raw ones have the distortion of recorded pictures, which the others do without."""


def preset_rig(name: str) -> Rig:
    """The rig of that name; ValueError lists those there are."""
    if name not in CAMERA_PRESETS:
        raise ValueError(f"there is no camera preset {name!r}: choose from {', '.join(CAMERA_PRESETS)}")
    return CAMERA_PRESETS[name]()
