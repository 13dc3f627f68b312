"""Pictures of scenes. Needs matplotlib (``pip install scjax[viz]``), which is only imported with this package."""

from scjax.viz.ahead import ahead
from scjax.viz.bev import plot
from scjax.viz.grid import grid

__all__ = ["ahead", "grid", "plot"]
