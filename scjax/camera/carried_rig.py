"""A rig on what carries it: poses of its cameras at every step of a log."""

from __future__ import annotations

import copy

import numpy as np

from scjax.camera.camera import Camera
from scjax.camera.presets import preset_rig
from scjax.camera.rig import CameraPoses, Rig, carried_poses, mounted_poses
from scjax.camera.source_log import LogGround, camera_log, carrier_index, ground_of, known_sizes
from scjax.scene import Log, Map, Scene


class CarriedRig:
    """A rig on an object of a log, or at given poses.

    Args:
      source: a single scene, a map or a log.
      rig: cameras, or the name of a preset.
      actor: index of the object that carries the rig, by default the ego.
      poses: of the frame of the rig, one for each step, instead of those of an upright carrier.

    Attributes:
      log: what the cameras look at.
      rig: the cameras.
      index: of the carrier; that of the ego, or ``NO_EGO``, for given poses.
      steps: those at which the carrier is there.
      ground: of the log, at the height of the carrier where lanes do not say.

    Raises:
      ValueError: there is no such carrier, or the poses do not fit the log.
    """

    def __init__(
        self, source: Scene | Map | Log, rig: Rig | str, *, actor: int | None = None, poses: CameraPoses | None = None
    ):
        self.rig = preset_rig(rig) if isinstance(rig, str) else rig
        self.log = log = camera_log(source)
        self.index = log.ego_index if poses is not None and actor is None else carrier_index(log, actor)
        self.ground = ground_of(log, self.index)
        if poses is None:
            self._stand_on_carrier()
        else:
            _check_poses(poses, log.num_steps)
            self._poses, self.steps, self._feet = poses, np.arange(log.num_steps), poses.translations

    def carried_by(self, actor: int) -> CarriedRig:
        """The rig on another object of the log, which is not checked again."""
        other = copy.copy(self)
        other.index = carrier_index(self.log, actor)
        other.ground = ground_of(self.log, other.index, self.ground)
        other._stand_on_carrier()
        return other

    def _stand_on_carrier(self) -> None:
        self._poses = None
        self.steps = np.flatnonzero(self.log.valid[self.index])
        self._feet = _feet(self.log, self.index, self.ground, self.steps)

    def camera_poses(self, camera: Camera) -> CameraPoses:
        """Poses of a camera of the rig; they mean nothing at steps at which the carrier is not there."""
        if self._poses is not None:
            return carried_poses(camera, self._poses)
        size = known_sizes(self.log)[self.index]
        return mounted_poses(self.rig, camera, self._feet, self.log.headings[self.index], size)

    def check_step(self, step: int) -> None:
        """Nothing, if the carrier is there at this step.

        Raises:
          ValueError: it is not, or the log has no such step.
        """
        if not 0 <= step < self.log.num_steps:
            raise ValueError(f"step is {step}: give one of the {self.log.num_steps} steps, counted from 0")
        if step not in self.steps:
            first, last = self.steps[[0, -1]]
            raise ValueError(f"step is {step}, but the carrier of the camera is there from step {first} to {last} only")


def _feet(log: Log, index: int, ground: LogGround, steps: np.ndarray) -> np.ndarray:
    """Middle of an object's box on the ground at each step [T, 3] m."""
    feet = log.positions[index].copy()
    feet[:, 2] = ground.level
    for step in steps[~np.isfinite(log.positions[index, steps, 2])].tolist():
        feet[step, 2] = ground.heights(feet[step : step + 1, :2], step)[0]
    return feet


def _check_poses(poses: CameraPoses, steps: int) -> None:
    rotations, translations = poses
    if rotations.shape != (steps, 3, 3) or translations.shape != (steps, 3):
        raise ValueError(
            f"poses have rotations {rotations.shape} and translations {translations.shape}: give one of each for "
            f"{steps} steps"
        )
    if not (np.isfinite(rotations).all() and np.isfinite(translations).all()):
        raise ValueError("poses hold NaN or infinity: give a pose for each step")
