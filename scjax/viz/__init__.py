"""Figures of scenes and animations of logs. Needs matplotlib, which is imported with this package only."""

from scjax.viz.animation import animate
from scjax.viz.bev import plot_scene
from scjax.viz.camera_view import camera_view_grid
from scjax.viz.grid import grid

__all__ = ["animate", "camera_view_grid", "grid", "plot_scene"]
