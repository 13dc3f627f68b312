"""A rendered dashcam: what a camera on an actor might photograph of a scene, map or log, with depth and classes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from scjax.camera.carried_rig import CarriedRig
from scjax.camera.dashcam.canvas import Canvas
from scjax.camera.dashcam.look import Look
from scjax.camera.dashcam.materials import Material
from scjax.camera.dashcam.road_surface import RoadSurface
from scjax.camera.dashcam.shading import add_windows, face_colors, finish, grain, ground_light, sky_colors
from scjax.camera.dashcam.world_solids import WorldSolids
from scjax.camera.dashcam.zbuffer import ZBuffer, picture_faces
from scjax.camera.projection import NEAR
from scjax.camera.raster import require_opencv
from scjax.camera.rig import CameraPoses, Rig
from scjax.scene import Log, Map, Scene

_GROUND_GRAIN, _LEAF_GRAIN = 0.10, 0.22  # shares of the brightness
_GRAIN_DEPTH = 15.0  # m; grain fades with depth


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
        shadows = self._solids.shadows(step, position, self.look.to_sun)
        ground, classes, background = self._surface.view(canvas.camera, rotation, position, shadows)
        ahead = rotation[:2, 2] / max(float(np.hypot(*rotation[:2, 2])), 1e-6)
        solids = self._solids.at(step, position, ahead)
        local = (solids.corners - position) @ rotation
        solid, face, polygons, planes, limits = picture_faces(canvas.camera, local, NEAR)
        buffer = ZBuffer(canvas.camera, background)
        buffer.draw(polygons, planes, limits)
        colors, normals = face_colors(solids, solid, face, self.look)
        picture = self._composed(buffer, ground, colors, normals, solids.materials[solid, face], rotation, position)
        faces = canvas.nearest(buffer.faces)
        on_face = faces >= 0
        classes = canvas.nearest(classes)
        classes[on_face] = solids.classes[solid[faces[on_face]]]
        ids = np.full(faces.shape, -1, np.int32)
        ids[on_face] = solids.ids[solid[faces[on_face]]]
        depth = canvas.depths(faces, planes, limits, rotation[2] / -position[2])
        classes[np.isinf(depth)] = 0
        rgb = finish(canvas.smooth(picture), self.camera, self.look, step)
        return DashcamFrame(rgb, depth, classes, ids)

    def frames(self, steps: Sequence[int] | np.ndarray | None = None) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        """Pictures one after the other, by default at all steps at which the carrier is there."""
        return (self.frame(int(step)).rgb for step in (self.steps if steps is None else steps))

    def _composed(
        self,
        buffer: ZBuffer,
        ground: np.ndarray,
        colors: np.ndarray,
        normals: np.ndarray,
        materials: np.ndarray,
        rotation: np.ndarray,
        position: np.ndarray,
    ) -> Float32[np.ndarray, "height width 3"]:
        """Colors of the canvas, with haze."""
        look, rays = self.look, self._canvas.rays @ rotation.T  # of the world, at depth 1
        inverse = buffer.inverse_depth.ravel()
        faces = buffer.faces.ravel()
        picture = np.empty((len(inverse), 3), np.float32)
        sky = inverse <= 0
        on_face = faces >= 0
        depth = 1 / np.where(sky, 1.0, inverse)
        below = np.flatnonzero(~sky & ~on_face)
        shine = ground_light(look).astype(np.float32)
        near = depth[below] < 3 * _GRAIN_DEPTH
        places = below[near]
        points = position[:2] + rays[places, :2] * depth[places, None]
        fade = np.float32(_GROUND_GRAIN) * np.exp(-depth[places] / _GRAIN_DEPTH)
        picture[below] = ground.reshape(-1, 3)[below] * shine
        picture[places] *= (1 + fade * (grain(points, 0.06) + grain(points, 0.5)))[:, None]
        shown = np.flatnonzero(on_face)
        picture[shown] = colors[faces[shown]]
        material = materials[faces[shown]] if len(materials) else np.zeros(0, int)
        walls, leaves = shown[material == Material.WALL], shown[material == Material.LEAVES]
        wall_colors = picture[walls]
        add_windows(wall_colors, position + rays[walls] * depth[walls, None], normals[faces[walls]], look)
        picture[walls] = wall_colors
        points = position + rays[leaves] * depth[leaves, None]
        picture[leaves] *= (1 + _LEAF_GRAIN * grain(points, 0.35))[:, None]
        haze = np.exp(-depth / look.visibility).astype(np.float32)[:, None]
        picture *= haze
        picture += (1 - haze) * (255 * np.array(look.horizon, np.float32))
        picture[sky] = sky_colors(rays[sky, 2] / np.linalg.norm(rays[sky], axis=-1), look)
        return picture.reshape(*buffer.faces.shape, 3)


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
