"""Borders of the road: the outline of all lanes as bands, for formats whose programs tell by it who is off the road."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from scjax.export.base import Losses
from scjax.export.roads.lane_network import LaneNetwork
from scjax.export.traffic import LANE_WIDTH

_MARGIN = 0.25  # m beside the outermost lane
_TOLERANCE = 0.1  # m that an outline is simplified by
_LEAST_AREA = 4.0  # m² of a hole that is no gap between bands


def road_edges(network: LaneNetwork, losses: Losses) -> list[Float64[np.ndarray, "_ 3"]]:
    """Closed outlines of the road [m], with the road on the left, at the height of the nearest lane.

    There are none where shapely is not installed, which ``losses`` says.
    """
    if importlib.util.find_spec("shapely") is None:
        losses["edges of the road, left out: they need shapely (pip install 'scjax[data]')"] += 1
        return []
    losses["edges of the road, made of the lanes' outlines"] += 1
    from scipy.spatial import KDTree

    points = np.concatenate(network.lines)
    tree = KDTree(points[:, :2])
    return [np.column_stack([ring, points[tree.query(ring)[1], 2]]) for ring in _outlines(network.lines)]


def _outlines(lines: Sequence[np.ndarray]) -> list[np.ndarray]:
    import shapely

    bands = [shapely.LineString(line[:, :2]).buffer(LANE_WIDTH / 2 + _MARGIN, cap_style="flat") for line in lines]
    union = shapely.union_all(bands).simplify(_TOLERANCE)
    outlines = []
    for part in getattr(union, "geoms", [union]):
        if part.is_empty or part.geom_type != "Polygon":
            continue
        part = shapely.geometry.polygon.orient(part)  # outside counter-clockwise, holes clockwise: road on the left
        rings = [part.exterior, *(ring for ring in part.interiors if shapely.Polygon(ring).area > _LEAST_AREA)]
        outlines += [np.array(ring.coords, np.float64)[:, :2] for ring in rings]
    return outlines
