"""A rendered dashcam: what a camera on an actor might photograph of a scene, map or log, with depth and classes."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from scjax.camera.carried_rig import CarriedRig
from scjax.camera.dashcam.canvas import Canvas
from scjax.camera.dashcam.composing import Surfaces, compose_colors
from scjax.camera.dashcam.look import Look
from scjax.camera.dashcam.road_surface import RoadSurface
from scjax.camera.dashcam.shading import face_colors, finish
from scjax.camera.dashcam.world_solids import WorldSolids
from scjax.camera.dashcam.zbuffer import ZBuffer, in_sight, picture_faces
from scjax.camera.projection import NEAR, project_faces
from scjax.camera.raster import convex_hull, fill_smooth, require_opencv
from scjax.camera.rig import CameraPoses, Rig
from scjax.scene import Log, Map, Scene


class DashcamFrame(NamedTuple):
    """A rendered picture.

    Attributes:
      rgb: the picture.
      depth: along the axis of the camera [m], inf in the sky.
      classes: ``SemanticClass``.
      ids: index of the object, -1 where there is none.
    """

    rgb: UInt8[np.ndarray, "height width 3"]
    depth: Float32[np.ndarray, "height width"]
    classes: UInt8[np.ndarray, "height width"]
    ids: Int32[np.ndarray, "height width"]


class DashcamRenderer:
    """Renders pictures of a scene, map or log from one camera. Nothing in them is a photograph.

    The ground is level at the height of the carrier; objects on it stand as high above it as above their lane.

    Args:
      source, rig, camera, actor, poses: as of ``WireframeRenderer``.
      look: light, weather, colors, mount and lens; ``random_look`` draws one from a seed.
      supersampling: pixels drawn for each of the picture, to both sides: 1 is fast, 2 is smoother.

    Attributes:
      log, steps: as of ``WireframeRenderer``.
      camera: with the mount and lens of the look.
      poses: of the camera, one for each step.
    """

    def __init__(
        self,
        source: Scene | Map | Log,
        rig: Rig | str = "dashcam",
        camera: str | None = None,
        *,
        actor: int | None = None,
        poses: CameraPoses | None = None,
        look: Look | None = None,
        supersampling: int = 1,
    ):
        self.look = look or Look()
        self._mount = CarriedRig(source, rig, actor=actor, poses=poses)
        self.log, self.steps = self._mount.log, self._mount.steps
        self.camera = self.look.varied_camera(self._mount.rig.camera(camera))
        self.poses = self._mount.camera_poses(self.camera)
        self._canvas = Canvas(self.camera, supersampling)
        self._solids = WorldSolids(self.log, self._mount.ground, self.look.seed, self._mount.index)
        self._surface = RoadSurface(self.log, self.look)

    def through(self, camera: str) -> DashcamRenderer:
        """The renderer of another camera of the rig, which shares what took time to prepare."""
        other = copy.copy(self)
        other.camera = self.look.varied_camera(self._mount.rig.camera(camera))
        other.poses = self._mount.camera_poses(other.camera)
        other._canvas = Canvas(other.camera, self._canvas.supersampling)
        return other

    def carried_by(self, actor: int, look: Look) -> DashcamRenderer:
        """The renderer on another object of the log, which shares what took time to prepare.

        Args:
          actor: index of the object.
          look: of its pictures; the ground, buildings, trees and paints keep the colors of this renderer's look.
        """
        other = copy.copy(self)
        other.look = look
        other._mount = self._mount.carried_by(actor)
        other.steps = other._mount.steps
        other.camera = look.varied_camera(other._mount.rig.camera(self.camera.name))
        other.poses = other._mount.camera_poses(other.camera)
        other._canvas = self._canvas.of_camera(other.camera)
        other._solids = self._solids.without(other._mount.index, other._mount.ground)
        return other

    @property
    def pixel_rays(self) -> Float64[np.ndarray, "height width 2"]:
        """x and y at depth 1 of what the pixels of the camera see."""
        return self._canvas.camera_rays()

    def frame(self, step: int = 0) -> DashcamFrame:
        """The picture at a step.

        Raises:
          ValueError: the log has no such step, or the carrier is not there; or OpenCV is missing.
        """
        require_opencv()
        self._mount.check_step(step)
        rotation = self.poses.rotations[step]
        position = self.poses.translations[step].copy()
        position[2] = max(position[2] - float(self._mount.ground.heights(position[None, :2], step)[0]), 0.1)
        canvas = self._canvas
        ground = self._surface.view(canvas.camera, rotation, position)
        ahead = rotation[:2, 2] / max(float(np.hypot(*rotation[:2, 2])), 1e-6)
        solids = self._solids.at(step, position, ahead)
        local = (solids.corners - position) @ rotation
        solid, face, polygons, planes, limits = picture_faces(canvas.camera, local, NEAR)
        buffer = ZBuffer(canvas.camera, ground.inverse_depth)
        buffer.draw(polygons, planes, limits)
        colors, normals = face_colors(solids, solid, face, self.look)
        shade = self._shade(step, rotation, position)
        surfaces = Surfaces(colors, normals, solids.materials[solid, face])
        picture = compose_colors(canvas.camera, buffer, ground.colors, shade, surfaces, (rotation, position), self.look)
        faces = canvas.nearest(buffer.faces)
        on_face = faces >= 0
        classes = canvas.nearest(ground.classes)
        classes[on_face] = solids.classes[solid[faces[on_face]]]
        ids = np.full(faces.shape, -1, np.int32)
        ids[on_face] = solids.ids[solid[faces[on_face]]]
        depth = canvas.depths(buffer.inverse_depth, faces, planes, limits, rotation[2] / -position[2])
        classes[np.isinf(depth)] = 0
        rgb = finish(canvas.smooth(picture), self.camera, self.look, step)
        return DashcamFrame(rgb, depth, classes, ids)

    def frames(self, steps: Sequence[int] | np.ndarray | None = None) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        """Pictures one after the other, by default at all steps at which the carrier is there."""
        return (self.frame(int(step)).rgb for step in (self.steps if steps is None else steps))

    def _shade(self, step: int, rotation: np.ndarray, position: np.ndarray) -> UInt8[np.ndarray, "height width"] | None:
        """How dark shadows make the ground in the canvas; None without any."""
        outlines = self._solids.shadows(step, position, self.look.to_sun)
        if not len(outlines) or self.look.shadows < 0.02:
            return None
        camera = self._canvas.camera
        flat = np.concatenate([outlines - position[:2], np.full((*outlines.shape[:2], 1), -position[2])], -1)
        flat = flat[in_sight(camera, flat @ rotation, NEAR)]
        if not len(flat):
            return None
        hulls = np.stack([_padded(convex_hull(outline[:, :2]), 8) for outline in flat])
        corners = np.concatenate([hulls, flat[..., 2:]], -1) @ rotation
        polygons = project_faces(camera, corners, NEAR)
        shade = np.zeros((camera.height, camera.width), np.uint8)
        for polygon in polygons[np.isfinite(polygons).all((1, 2))]:
            fill_smooth(shade, polygon, round(255 * self.look.shadows))
        return shade


def _padded(points: np.ndarray, count: int) -> np.ndarray:
    """Points with the last one repeated."""
    return points[np.minimum(np.arange(count), len(points) - 1)]


def render_dashcam(
    source: Scene | Map | Log,
    rig: Rig | str = "dashcam",
    camera: str | None = None,
    *,
    steps: Sequence[int] | np.ndarray | None = None,
    size: tuple[int, int] | None = None,
    actor: int | None = None,
    look: Look | None = None,
) -> list[DashcamFrame]:
    """Rendered pictures of a scene, map or log; ``DashcamRenderer`` makes them one by one.

    Args:
      source, rig, camera, actor, look: as of ``DashcamRenderer``.
      steps: of a log; by default all at which the carrier is there.
      size: width and height of the pictures; by default those of the camera.
    """
    mount = CarriedRig(source, rig, actor=actor)
    chosen = dataclasses.replace(mount.rig, cameras=(mount.rig.camera(camera),))
    chosen = chosen if size is None else chosen.fitted(*size)
    renderer = DashcamRenderer(mount.log, chosen, actor=mount.index, look=look)
    return [renderer.frame(int(step)) for step in (renderer.steps if steps is None else steps)]
