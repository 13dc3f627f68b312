"""Wireframes of scenes, maps and logs from the cameras of an actor, as pictures and sequences."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from scjax.camera.carried_rig import CarriedRig
from scjax.camera.palettes import palette_of
from scjax.camera.photo import as_photo
from scjax.camera.presets import preset_rig
from scjax.camera.rig import CameraPoses, Rig
from scjax.camera.wireframe import WireframeFrame, WireframeStyle, draw_wireframe
from scjax.camera.wireframe_scene import WireframeScene
from scjax.scene import Log, Map, Scene

MAX_FRAMES_AT_ONCE = 2_000_000_000
"""Bytes of pictures that ``render_wireframe`` returns at once."""


class WireframeRenderer:
    """Draws the wireframes of a scene, map or log from one camera.

    Args:
      source: a single scene, a map or a log.
      rig: cameras, or the name of a preset.
      camera: name of the camera; not needed if there is one.
      actor: index of the object that carries the rig, by default the ego. Its own box is not drawn.
      poses: of the frame of the rig, one for each step, instead of those of an upright carrier. The ego, or ``actor``,
        is not drawn.
      style: how the wireframe looks.

    Attributes:
      log: what is drawn.
      camera: the camera.
      poses: of the camera, one for each step; they mean nothing at steps that are not in ``steps``.
      steps: those at which the carrier is there.
    """

    def __init__(
        self,
        source: Scene | Map | Log,
        rig: Rig | str,
        camera: str | None = None,
        *,
        actor: int | None = None,
        poses: CameraPoses | None = None,
        style: WireframeStyle | None = None,
    ):
        self.style = style or WireframeStyle()
        self._mount = CarriedRig(source, rig, actor=actor, poses=poses)
        self.log, self.steps = self._mount.log, self._mount.steps
        self.camera = self._mount.rig.camera(camera)
        self.poses = self._mount.camera_poses(self.camera)
        self._scene = WireframeScene(
            self.log,
            self._mount.ground,
            palette_of(self.style.palette),
            borders=self.style.borders,
            left_out=self._mount.index,
            snap_to_ground=self.style.snap_to_ground,
        )

    def through(self, camera: str) -> WireframeRenderer:
        """The renderer of another camera of the rig, which shares what took time to prepare."""
        other = copy.copy(self)
        other.camera = self._mount.rig.camera(camera)
        other.poses = self._mount.camera_poses(other.camera)
        return other

    def frame(
        self, step: int = 0, *, background: UInt8[np.ndarray, "height width 3"] | None = None, buffers: bool = False
    ) -> WireframeFrame:
        """The picture at a step.

        Args:
          background: picture of the camera's size to draw on; black by default.
          buffers: make depth, ids and kinds too.

        Raises:
          ValueError: the log has no such step, or the carrier is not there; or the background is of another size.
        """
        self._mount.check_step(step)
        camera = self.camera
        if background is not None and background.shape != (camera.height, camera.width, 3):
            raise ValueError(
                f"the background is of shape {background.shape}: the camera {camera.name!r} takes pictures of "
                f"{camera.width} x {camera.height}"
            )
        rotation, position = self.poses.rotations[step], self.poses.translations[step]
        options: dict[str, Any] = {"background": background, "buffers": buffers}
        return draw_wireframe(self._scene, step, camera, rotation, position, self.style, **options)

    def frames(self, steps: Sequence[int] | np.ndarray | None = None) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        """Pictures one after the other, by default at all steps at which the carrier is there."""
        return (self.frame(int(step)).rgb for step in (self.steps if steps is None else steps))


def render_wireframe(
    source: Scene | Map | Log,
    rig: Rig | str = "dashcam",
    camera: str | None = None,
    *,
    steps: Sequence[int] | np.ndarray | None = None,
    actor: int | None = None,
    poses: CameraPoses | None = None,
    style: WireframeStyle | None = None,
) -> UInt8[np.ndarray, "T height width 3"]:
    """Wireframes of a scene, map or log; ``WireframeRenderer`` draws them one by one, with depth and ids.

    Args:
      source, rig, camera, actor, poses, style: as of ``WireframeRenderer``.
      steps: of a log; by default all at which the carrier is there.

    Raises:
      ValueError: an argument is out of range or names what is not there; OpenCV is missing; or the pictures would take
        more than 2 GB.
    """
    renderer = WireframeRenderer(source, rig, camera, actor=actor, poses=poses, style=style)
    chosen = renderer.steps if steps is None else np.asarray(steps, int)
    size = len(chosen) * renderer.camera.height * renderer.camera.width * 3
    if not len(chosen) or size > MAX_FRAMES_AT_ONCE:
        raise ValueError(
            f"{len(chosen)} pictures of {size / 1e9:.1f} GB: choose steps, or use WireframeRenderer.frames"
        )
    return np.stack(list(renderer.frames(chosen)))


def overlay(
    photograph: str | Path | UInt8[np.ndarray, "height width channels"],
    source: Scene | Map | Log,
    rig: Rig | str,
    camera: str | None = None,
    *,
    step: int = 0,
    actor: int | None = None,
    poses: CameraPoses | None = None,
    style: WireframeStyle | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """A photograph with the wireframe of what its camera saw.

    Args:
      photograph: file or RGB picture. A picture of another size must have the shape of the camera's.
      source, rig, camera, actor, poses, style: as of ``WireframeRenderer``. By default boxes do not darken the picture.
      step: of a log.

    Raises:
      ValueError: as ``render_wireframe``; or the photograph cannot be read, or has another shape.
    """
    picture = as_photo(photograph).pixels
    rig = preset_rig(rig) if isinstance(rig, str) else rig
    height, width = picture.shape[:2]
    chosen = rig.camera(camera)
    chosen.check_proportions(width, height)
    rig = dataclasses.replace(rig, cameras=(chosen.resized(width, height),))
    style = style or WireframeStyle(occlusion=False, depth_cue=0.3)
    renderer = WireframeRenderer(source, rig, actor=actor, poses=poses, style=style)
    return renderer.frame(step, background=picture).rgb
