"""Figures of scenes. Needs matplotlib (``pip install scjax[viz]``), which is imported with this package only."""

from scjax.viz.bev import plot_scene
from scjax.viz.camera_view import camera_view_grid
from scjax.viz.grid import grid

__all__ = ["camera_view_grid", "grid", "plot_scene"]
