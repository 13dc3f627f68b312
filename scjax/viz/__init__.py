"""Figures of scenes and maps, and animations of logs. Needs matplotlib, which is imported with this package only."""

from scjax.viz.animation import animate, frames_of
from scjax.viz.bev import plot_scene
from scjax.viz.camera_view import camera_view_grid
from scjax.viz.grid import grid
from scjax.viz.map_view import plot_map

__all__ = ["animate", "camera_view_grid", "frames_of", "grid", "plot_map", "plot_scene"]
