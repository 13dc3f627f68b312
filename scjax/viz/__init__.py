"""Pictures of scenes. Needs matplotlib (``pip install scjax[viz]``), which is only imported with this package."""

from scjax.viz.bev import plot_scene
from scjax.viz.camera_view import ahead
from scjax.viz.grid import grid

__all__ = ["ahead", "grid", "plot_scene"]
