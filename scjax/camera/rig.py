"""Cameras on a carrier: the ego, or any other agent."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from scjax.camera.camera import Camera
from scjax.scene.limits import MAX_COORDINATE, MAX_SIZE


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """Cameras and the frame in which they are mounted.

    The frame of a rig has x ahead, y to the left and z up. ``origin`` says where it lies on the carrier: data sets use
    the middle of the rear axle, on the ground or at the height of the axle.

    Attributes:
      name: of the rig.
      cameras: at least one, with unique names.
      origin: of the rig's frame, from the middle of the carrier's box on the ground [m].
      carrier_size: length, width, height of the car for which the mount was made [m]. On agents of other sizes the
        mount is scaled. None: it never is.

    Raises:
      ValueError: naming the field at fault, what is wrong and how to mend it.
    """

    name: str
    cameras: tuple[Camera, ...]
    origin: Float64[np.ndarray, " 3"] = dataclasses.field(default_factory=lambda: np.zeros(3))
    carrier_size: Float64[np.ndarray, " 3"] | None = None

    def __post_init__(self):
        if not self.cameras:
            raise ValueError(f"rig {self.name!r} has no cameras: give at least one")
        names = [camera.name for camera in self.cameras]
        if len(set(names)) < len(names):
            raise ValueError(f"rig {self.name!r}: the names of its cameras {names} repeat: give each its own")
        if self.origin.shape != (3,) or not (np.abs(self.origin) < MAX_COORDINATE).all():
            raise ValueError(f"rig {self.name!r}: origin must be three finite numbers, not {self.origin.tolist()}")
        size = self.carrier_size
        if size is not None and (size.shape != (3,) or not ((size > 0) & (size <= MAX_SIZE)).all()):
            raise ValueError(f"rig {self.name!r}: carrier_size must be three lengths in 0..{MAX_SIZE:g} m")

    def camera(self, name: str | None = None) -> Camera:
        """The camera of that name; the only one if no name is given.

        Raises:
          ValueError: there is none, or there are several.
        """
        if name is None and len(self.cameras) == 1:
            return self.cameras[0]
        names = {camera.name: camera for camera in self.cameras}
        if name not in names:
            problem = f"has {len(names)} cameras" if name is None else f"has no camera {name!r}"
            raise ValueError(f"rig {self.name!r} {problem}: name one of {', '.join(names)}")
        return names[name]

    def select(self, *names: str) -> Rig:
        """The rig with some of its cameras; ValueError if one is not there."""
        return dataclasses.replace(self, cameras=tuple(self.camera(name) for name in names))

    def fitted(self, width: int, height: int) -> Rig:
        """The rig with pictures of another size; as ``Camera.fitted``."""
        return dataclasses.replace(self, cameras=tuple(camera.fitted(width, height) for camera in self.cameras))


class CameraPoses(NamedTuple):
    """Poses of a frame in the frame of a log, one for each step.

    Attributes:
      rotations: columns are the axes of the frame.
      translations: its origin [m].
    """

    rotations: Float64[np.ndarray, "T 3 3"]
    translations: Float64[np.ndarray, "T 3"]


def mounted_poses(
    rig: Rig,
    camera: Camera,
    ground: Float64[np.ndarray, "T 3"],
    headings: Float64[np.ndarray, " T"],
    size: Float64[np.ndarray, " 3"],
) -> CameraPoses:
    """Poses of a camera on an upright carrier.

    Args:
      ground: middle of the carrier's box on the ground [m].
      headings: of the carrier [rad].
      size: its length, width and height [m].
    """
    scale = np.ones(3) if rig.carrier_size is None else size / rig.carrier_size
    mount = scale * (rig.origin + camera.translation)
    cos, sin, zero = np.cos(headings), np.sin(headings), np.zeros_like(headings)
    turns = np.stack([cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1], -1).reshape(-1, 3, 3)
    return CameraPoses(turns @ camera.rotation, ground + turns @ mount)


def carried_poses(camera: Camera, frames: CameraPoses) -> CameraPoses:
    """Poses of a camera whose rig has these poses, as data sets record them."""
    return CameraPoses(frames.rotations @ camera.rotation, frames.translations + frames.rotations @ camera.translation)
