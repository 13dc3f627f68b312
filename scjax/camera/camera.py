"""A pinhole camera with an optional lens distortion, and where it is mounted.

Camera axes are those of OpenCV: x right, y down, z ahead. Whole pixel coordinates are the centers of pixels.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from jaxtyping import Float64

from scjax.camera.distortion import NO_DISTORTION
from scjax.scene.limits import MAX_COORDINATE

MAX_PIXELS = 16384  # of a side of a picture
_ORTHOGONAL = 1e-3  # largest error of the dot products of the axes; calibrations are rounded
_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # camera that looks along x of its rig


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A camera of a rig.

    Attributes:
      name: unique within the rig.
      width, height: of the picture [pixels].
      intrinsic: focal lengths and principal point [pixels]; the last row is 0, 0, 1.
      rotation: its columns are the axes of the camera in the frame of the rig.
      translation: position of the camera in the frame of the rig [m].
      distortion: k1, k2, p1, p2, k3 of the lens; zeros for none.

    Raises:
      ValueError: naming the field at fault, what is wrong and how to mend it.
    """

    name: str
    width: int
    height: int
    intrinsic: Float64[np.ndarray, "3 3"]
    rotation: Float64[np.ndarray, "3 3"]
    translation: Float64[np.ndarray, " 3"]
    distortion: Float64[np.ndarray, " 5"] = dataclasses.field(default_factory=lambda: np.array(NO_DISTORTION))

    def __post_init__(self):
        _check_camera(self)

    @property
    def field_of_view(self) -> tuple[float, float]:
        """Horizontal and vertical angle between the borders of the picture, without distortion [degrees]."""
        (fx, _, cx), (_, fy, cy), _ = self.intrinsic.tolist()
        sides = ((cx + 0.5, self.width - 0.5 - cx, fx), (cy + 0.5, self.height - 0.5 - cy, fy))
        one, other = (math.degrees(math.atan(low / f) + math.atan(high / f)) for low, high, f in sides)
        return one, other

    @property
    def is_distorted(self) -> bool:
        """Whether the lens bends lines."""
        return bool(self.distortion.any())

    def resized(self, width: int, height: int) -> Camera:
        """The camera whose pictures have another size: each axis is scaled as a whole."""
        scale = np.array([width / self.width, height / self.height])
        intrinsic = self.intrinsic.copy()
        intrinsic[0] *= scale[0]
        intrinsic[1] *= scale[1]
        intrinsic[:2, 2] += 0.5 * scale - 0.5  # pixel centers are whole numbers
        return dataclasses.replace(self, width=width, height=height, intrinsic=intrinsic)

    def check_proportions(self, width: int, height: int) -> None:
        """Checks that a picture of that size can be the whole picture of the camera, scaled.

        Raises:
          ValueError: its proportions differ by more than a pixel.
        """
        if abs(width * self.height - height * self.width) > max(self.width, self.height):
            raise ValueError(
                f"the camera {self.name!r} takes pictures of {self.width} x {self.height} pixels, and this one has "
                f"{width} x {height}: give the whole picture, or the camera of its part (Camera.cropped)"
            )

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """The camera of a part of its picture [pixels]."""
        intrinsic = self.intrinsic.copy()
        intrinsic[:2, 2] -= (left, top)
        return dataclasses.replace(self, width=width, height=height, intrinsic=intrinsic)

    def fitted(self, width: int, height: int) -> Camera:
        """The camera of a picture of that size: scaled by one factor to fill it, and cut equally on both sides."""
        scale = max(width / self.width, height / self.height)
        full = self.resized(max(width, round(scale * self.width)), max(height, round(scale * self.height)))
        return full.cropped((full.width - width) // 2, (full.height - height) // 2, width, height)


def pinhole(
    name: str,
    width: int,
    height: int,
    *,
    focal_length: float | None = None,
    field_of_view: float = 64.0,
    center: tuple[float, float] | None = None,
    position: tuple[float, float, float] = (0.0, 0.0, 1.5),
    yaw: float = 0.0,
    pitch: float = 0.0,
    roll: float = 0.0,
) -> Camera:
    """A camera without distortion.

    Args:
      name, width, height: as in ``Camera``.
      focal_length: [pixels]; by default that of ``field_of_view``.
      field_of_view: horizontal angle [degrees].
      center: principal point [pixels]; by default the middle of the picture.
      position: in the frame of the rig [m].
      yaw, pitch, roll: turn to the left, up and clockwise as seen from behind [degrees]; all 0 looks along x.

    Raises:
      ValueError: as ``Camera``; or the angle is out of range.
    """
    if not 0.1 <= field_of_view <= 175.0:
        raise ValueError(f"field_of_view is {field_of_view} degrees: give a number from 0.1 to 175")
    focal = focal_length or width / 2 / math.tan(math.radians(field_of_view) / 2)
    cx, cy = center or ((width - 1) / 2, (height - 1) / 2)
    return Camera(
        name=name,
        width=width,
        height=height,
        intrinsic=np.array([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]]),
        rotation=camera_rotation(yaw, pitch, roll),
        translation=np.array(position, np.float64),
    )


def camera_rotation(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Float64[np.ndarray, "3 3"]:
    """Columns are the axes of a camera that looks along x, then rolls, looks up and turns left by angles [degrees]."""
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(a), math.sin(a)) for a in map(math.radians, (yaw, pitch, roll)))
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, -sp], [0.0, 1.0, 0.0], [sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return about_z @ about_y @ about_x @ _AXES


def _check_camera(camera: Camera) -> None:
    name = f"camera {camera.name!r}"
    if not camera.name:
        raise ValueError("a camera has an empty name: give one")
    for side in ("width", "height"):
        if not 1 <= getattr(camera, side) <= MAX_PIXELS:
            raise ValueError(f"{name}: {side} is {getattr(camera, side)}: give 1 to {MAX_PIXELS} pixels")
    for field, shape in (("intrinsic", (3, 3)), ("rotation", (3, 3)), ("translation", (3,)), ("distortion", (5,))):
        value = getattr(camera, field)
        if value.shape != shape or not (np.abs(value) < MAX_COORDINATE).all():
            raise ValueError(f"{name}: {field} must be finite numbers of shape {shape}, not {value.tolist()}")
    intrinsic = camera.intrinsic
    if (intrinsic[2] != (0, 0, 1)).any() or intrinsic[1, 0] or min(intrinsic[0, 0], intrinsic[1, 1]) <= 0:
        raise ValueError(
            f"{name}: intrinsic is {intrinsic.tolist()}: give [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0"
        )
    rotation = camera.rotation
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > _ORTHOGONAL or np.linalg.det(rotation) < 0:
        raise ValueError(f"{name}: rotation {rotation.tolist()} turns no frame: its columns are no right-handed axes")
