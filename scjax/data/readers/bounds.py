"""Lanes that a source gives by their left and right bounds."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from scjax.scene.polyline import cumulative_length


def middle_line(
    left: Float64[np.ndarray, "left 3"], right: Float64[np.ndarray, "right 3"]
) -> Float64[np.ndarray, "points 3"]:
    """The line in the middle of two bounds: pairs of points at equal shares of their lengths [m].

    It has the points of both bounds, so that bends keep their shape. z is NaN if it is not known on either side.
    """
    shares = [_shares(bound) for bound in (left, right)]
    places = np.unique(np.concatenate(shares).round(9))
    sides = [
        np.stack([np.interp(places, share, column) for column in bound.T], -1)
        for share, bound in zip(shares, (left, right), strict=True)
    ]
    return (sides[0] + sides[1]) / 2


def _shares(bound: np.ndarray) -> np.ndarray:
    """Arc length at each point as a share of the whole; counted by points where the bound has no length."""
    arc = cumulative_length(bound)
    return arc / arc[-1] if arc[-1] > 0 else np.linspace(0.0, 1.0, len(bound))
