"""A photograph beside the scene that was generated from it, seen from above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from scjax.camera.camera import Camera
from scjax.camera.photo import Photo
from scjax.camera.projection import pixel_rays
from scjax.camera.render import overlay
from scjax.camera.rig import Rig
from scjax.scene import TILE_SIZE, Scene
from scjax.viz.bev import INK, legend_below, plot_scene
from scjax.viz.grid import save_figure

_LARGEST = 1280  # pixels of the longer side of the photograph
_HEIGHT = 4.2  # inches
_MOST_ASPECT = 3.0


def photo_view(photo: Photo, scene: Scene, rig: Rig | None = None, *, path: str | Path | None = None) -> Figure:
    """The photograph, with the wireframe of the scene on it if its camera is known, beside the bird's-eye view.

    Args:
      scene: a single scene.
      rig: of the one camera that took the picture, on the ego. Dashed lines show its angle in the bird's-eye view.
      path: PNG or SVG file to write as well.

    Raises:
      ValueError: the camera takes pictures of other proportions, or OpenCV is missing.
    """
    pixels = small_pixels(photo, None if rig is None else rig.camera())
    aspect = min(max(pixels.shape[1] / pixels.shape[0], 1 / _MOST_ASPECT), _MOST_ASPECT)
    figure = Figure(figsize=(_HEIGHT * (aspect + 1), _HEIGHT), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(aspect, 1))
    left.imshow(pixels if rig is None else overlay(pixels, scene, rig), interpolation="antialiased")
    left.set(xticks=[], yticks=[])
    plot_scene(scene, ax=right)
    legend_below(figure, [scene], right=True)
    right.set(xlabel="", ylabel="")
    if rig is not None:
        _draw_sides(right, rig, rig.camera())
    if path is not None:
        save_figure(figure, path)
    return figure


def small_pixels(
    photo: Photo, camera: Camera | None = None, largest: int = _LARGEST
) -> UInt8[np.ndarray, "height width 3"]:
    """RGB of a photograph, made smaller to at most so many pixels of its longer side.

    Args:
      camera: that took it; the proportions are exactly those of its pictures then.

    Raises:
      ValueError: the camera takes pictures of other proportions.
    """
    height, width = photo.size
    scale = min(1.0, largest / max(height, width))
    if camera is not None:
        camera.check_proportions(width, height)
        height = width * camera.height / camera.width
    size = max(1, round(scale * width)), max(1, round(scale * height))
    if size == photo.size[::-1]:
        return photo.pixels
    return np.asarray(Image.fromarray(photo.pixels).resize(size, Image.Resampling.BOX))


def _draw_sides(ax: Axes, rig: Rig, camera: Camera) -> None:
    """Lines along which the sides of the picture look."""
    limits = ax.get_xlim(), ax.get_ylim()
    row = (camera.height - 1) / 2
    rays = pixel_rays(camera, np.array([[0.0, row], [camera.width - 1.0, row]]))
    start = rig.origin + camera.translation
    for x, y in rays[np.isfinite(rays).all(-1)].tolist():
        ray = camera.rotation @ np.array([x, y, 1.0])
        end = start + ray * (2 * TILE_SIZE / max(float(np.hypot(*ray[:2])), 1e-6))
        ax.plot([start[0], end[0]], [start[1], end[1]], color=INK, lw=0.7, ls="--", zorder=4)
    ax.set(xlim=limits[0], ylim=limits[1])
