"""Cameras on the ego or any other agent: rigs, projection, wireframes of scenes and logs, overlays on photographs.

Pictures need the extra ``camera``: ``pip install 'scjax[camera]'``.
"""

from scjax.camera.calibrations import CameraCalibration, read_calibration, read_nuscenes_calibration
from scjax.camera.camera import Camera, camera_rotation, pinhole
from scjax.camera.palettes import PALETTES, Palette
from scjax.camera.pose_file import write_camera_poses
from scjax.camera.presets import CAMERA_PRESETS, preset_rig
from scjax.camera.projection import project_points, project_segments
from scjax.camera.render import WireframeRenderer, overlay, render_wireframe
from scjax.camera.rig import CameraPoses, Rig
from scjax.camera.rig_file import read_rig, write_rig
from scjax.camera.wireframe import WireframeFrame, WireframeStyle
from scjax.camera.wireframe_scene import ElementKind

__all__ = [
    "CAMERA_PRESETS",
    "PALETTES",
    "Camera",
    "CameraCalibration",
    "CameraPoses",
    "ElementKind",
    "Palette",
    "Rig",
    "WireframeFrame",
    "WireframeRenderer",
    "WireframeStyle",
    "camera_rotation",
    "overlay",
    "pinhole",
    "preset_rig",
    "project_points",
    "project_segments",
    "read_calibration",
    "read_nuscenes_calibration",
    "read_rig",
    "render_wireframe",
    "write_camera_poses",
    "write_rig",
]
