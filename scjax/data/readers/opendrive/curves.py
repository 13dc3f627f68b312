"""The curves that a reference line is made of, each in its own frame: it starts at 0, 0 with heading 0."""

from __future__ import annotations

import dataclasses
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

MAX_TURN = 100.0  # rad, of one curve
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_PANEL_TURN = 0.5  # rad that one panel of quadrature may turn: error below 1e-14 of its length
_PANEL_LENGTH = 1.0  # m of one panel of arc length

LocalPoses = Float64[np.ndarray, "n 3"]
"""u forward, v to the left [m], heading [rad] of each place."""


@runtime_checkable
class Curve(Protocol):
    """A curve by arc length."""

    def poses(self, ds: Float64[np.ndarray, " n"]) -> LocalPoses:
        """Poses at the distances ``ds`` [m] from its start."""
        ...


@dataclasses.dataclass(frozen=True)
class Line:
    """A straight line."""

    def poses(self, ds: Float64[np.ndarray, " n"]) -> LocalPoses:
        """As ``Curve.poses``."""
        return np.stack([ds, np.zeros_like(ds), np.zeros_like(ds)], -1)


@dataclasses.dataclass(frozen=True)
class Arc:
    """A circle of constant curvature [1/m], positive to the left."""

    curvature: float

    def poses(self, ds: Float64[np.ndarray, " n"]) -> LocalPoses:
        """As ``Curve.poses``."""
        turn = self.curvature * ds
        # sin(x)/x and (1 - cos(x))/x without a division by 0.
        half = np.sinc(turn / (2 * np.pi))
        return np.stack([ds * np.sinc(turn / np.pi), ds * np.sin(turn / 2) * half, turn], -1)


@dataclasses.dataclass(frozen=True)
class Spiral:
    """A clothoid: the curvature changes linearly with the arc length.

    Attributes:
      start, end: curvatures [1/m].
      length: [m].
    """

    start: float
    end: float
    length: float

    def poses(self, ds: Float64[np.ndarray, " n"]) -> LocalPoses:
        """As ``Curve.poses``, by Gauss-Legendre quadrature of the heading."""
        rate = (self.end - self.start) / self.length
        turn = max(abs(self.start), abs(self.end)) * float(np.abs(ds).max(initial=0.0))
        panels = int(turn / _PANEL_TURN) + 1
        # Places of all nodes as shares of ds: [panels, nodes].
        shares = (np.arange(panels)[:, None] + (1 + _NODES) / 2) / panels
        places = ds[:, None, None] * shares
        headings = places * (self.start + rate / 2 * places)
        weights = _WEIGHTS / (2 * panels)
        u, v = ((function(headings) * weights).sum((1, 2)) * ds for function in (np.cos, np.sin))
        return np.stack([u, v, ds * (self.start + rate / 2 * ds)], -1)


@dataclasses.dataclass(frozen=True)
class Poly3:
    """v as a cubic polynomial of u (poly3, deprecated in the standard).

    Attributes:
      coefficients: a, b, c, d.
      length: arc length [m].
    """

    coefficients: tuple[float, float, float, float]
    length: float

    def poses(self, ds: Float64[np.ndarray, " n"]) -> LocalPoses:
        """As ``Curve.poses``; u is found from the arc length by Newton's method."""
        a, b, c, d = self.coefficients
        panels = int(self.length / _PANEL_LENGTH) + 16
        grid = np.linspace(0.0, self.length, panels + 1)
        arc = np.concatenate([[0.0], np.cumsum(self._arc(grid[:-1], grid[1:]))])
        u = np.interp(ds, arc, grid)
        row = np.clip(np.searchsorted(grid, u, side="right") - 1, 0, panels - 1)
        for _ in range(6):
            u = u - (arc[row] + self._arc(grid[row], u) - ds) / np.hypot(1.0, self._slope(u))
        return np.stack([u, a + u * (b + u * (c + u * d)), np.arctan(self._slope(u))], -1)

    def _slope(self, u: np.ndarray) -> np.ndarray:
        _, b, c, d = self.coefficients
        return b + u * (2 * c + 3 * d * u)

    def _arc(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Arc length from ``low`` to ``high``, both u [m]."""
        half = (high - low) / 2
        nodes = (low + high)[:, None] / 2 + half[:, None] * _NODES
        return half * (np.hypot(1.0, self._slope(nodes)) * _WEIGHTS).sum(-1)


@dataclasses.dataclass(frozen=True)
class ParamPoly3:
    """u and v as cubic polynomials of a parameter p (paramPoly3).

    Attributes:
      u, v: a, b, c, d of each.
      scale: p for each meter: 1 if p is an arc length, 1 / length if p runs from 0 to 1.
    """

    u: tuple[float, float, float, float]
    v: tuple[float, float, float, float]
    scale: float

    def poses(self, ds: Float64[np.ndarray, " n"]) -> LocalPoses:
        """As ``Curve.poses``; as the standard says, p is proportional to the distance."""
        p = self.scale * ds
        (u, du), (v, dv) = (
            (a + p * (b + p * (c + p * d)), b + p * (2 * c + 3 * d * p)) for a, b, c, d in (self.u, self.v)
        )
        return np.stack([u, v, np.arctan2(dv, du)], -1)
