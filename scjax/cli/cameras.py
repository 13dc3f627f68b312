"""The option --camera: a preset, a file of a rig, or the calibration of a recorded moment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from scjax.camera import Camera, CameraCalibration, Rig


def read_camera_option(camera: str) -> CameraCalibration:
    """The cameras that --camera names.

    Raises:
      ValueError: it is no preset and no file, or the file is damaged.
    """
    from scjax.camera import CAMERA_PRESETS, CameraCalibration, preset_rig, read_calibration

    if camera in CAMERA_PRESETS:
        return CameraCalibration(preset_rig(camera))
    if not Path(camera).is_file():
        raise ValueError(
            f"--camera is {camera!r}: there is no such file, and no preset of that name: choose from "
            f"{', '.join(CAMERA_PRESETS)}"
        )
    return read_calibration(camera)


def camera_ahead(camera: str) -> Camera:
    """The only camera that --camera names, in the frame of the ego.

    Raises:
      ValueError: as ``read_camera_option``; or there are several, or it looks aside.
    """
    from scjax.generate.camera_stream import picture_camera

    rig = read_camera_option(camera).rig
    try:
        only = rig.camera()
        return picture_camera(rig, (only.height, only.width))
    except ValueError as error:
        raise ValueError(f"--camera {camera}: {error}") from error


def rig_of_photo(calibration: CameraCalibration, rig: Rig, photo: str, option: str) -> Rig:
    """``rig`` with the camera that took a photograph: its only one, or the one whose picture has that name.

    Args:
      rig: all or some cameras of the calibration.
      option: that names the camera, for messages.

    Raises:
      ValueError: there are several cameras, and none has that picture.
    """
    if len(rig.cameras) == 1:
        return rig
    pictures = {Path(picture).name: name for name, picture in calibration.pictures.items() if picture}
    if Path(photo).name not in pictures:
        raise ValueError(f"rig {rig.name!r} has {len(rig.cameras)} cameras: say which took {photo} with {option}")
    return rig.select(pictures[Path(photo).name])
