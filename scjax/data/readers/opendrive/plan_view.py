"""The reference line of a road in the plane: curves in a row."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

from scjax.data.readers.opendrive.curves import MAX_TURN, Arc, Curve, Line, ParamPoly3, Poly3, Spiral
from scjax.data.readers.xml_elements import Element
from scjax.scene.limits import MAX_COORDINATE

_MAX_LENGTH = 1e6  # m of one curve
_MAX_CURVATURE = 100.0  # 1/m
_MAX_HEADING = 1000.0  # rad


@dataclasses.dataclass(frozen=True)
class PlanView:
    """Curves in a row, each placed by its own start pose.

    Attributes:
      starts: where each begins on the road [m], increasing.
      origins: x, y [m] and heading [rad] at the start of each.
      curves: their shapes.
    """

    starts: Float64[np.ndarray, " curves"]
    origins: Float64[np.ndarray, "curves 3"]
    curves: tuple[Curve, ...]

    def poses(self, s: Float64[np.ndarray, " n"], at: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n 3"]:
        """x, y [m] and heading [rad] at ``s``.

        Args:
          at: places [m] that say which curve counts, as in ``Cubics.values``.
        """
        row = np.maximum(np.searchsorted(self.starts, at, side="right") - 1, 0)
        poses = np.empty((len(s), 3))
        for k in np.unique(row):
            here = row == k
            u, v, turn = self.curves[k].poses(s[here] - self.starts[k]).T
            x, y, heading = self.origins[k]
            cos, sin = np.cos(heading), np.sin(heading)
            poses[here] = np.stack([x + cos * u - sin * v, y + sin * u + cos * v, heading + turn], -1)
        return poses


def read_plan_view(road: Element) -> PlanView:
    """The reference line of a <road>.

    Raises:
      ValueError: it has no curve, a curve of an unknown kind, or a number that is missing or absurd; says where.
    """
    plan = road.first("planView")
    elements = plan.all("geometry") if plan is not None else []
    if not elements:
        raise road.fault("has no <planView> with a <geometry>")
    rows = sorted((_read_geometry(element) for element in elements), key=lambda row: row[0])
    starts, origins, curves = zip(*rows, strict=True)
    return PlanView(np.array(starts), np.array(origins), curves)


def _read_geometry(element: Element) -> tuple[float, tuple[float, float, float], Curve]:
    """Start [m], pose there and shape of a <geometry>."""
    length = element.number("length", most=_MAX_LENGTH)
    if length < 0:
        raise element.fault(f"length is {length:g}: it must not be negative")
    x, y = (element.number(name, most=MAX_COORDINATE) for name in "xy")
    origin = (x, y, element.number("hdg", most=_MAX_HEADING))
    shape = next((child for child in element.children if child.tag in _READERS), None)
    if shape is None:
        raise element.fault(f"holds none of {', '.join(_READERS)}")
    return element.number("s"), origin, _READERS[shape.tag](shape, max(length, 1e-9))


def _read_line(element: Element, length: float) -> Curve:
    return Line()


def _read_arc(element: Element, length: float) -> Curve:
    return Arc(_curvature(element, "curvature", length))


def _read_spiral(element: Element, length: float) -> Curve:
    return Spiral(_curvature(element, "curvStart", length), _curvature(element, "curvEnd", length), length)


def _read_poly3(element: Element, length: float) -> Curve:
    a, b, c, d = (element.number(name, 0.0) for name in "abcd")
    return Poly3((a, b, c, d), length)


def _read_param_poly3(element: Element, length: float) -> Curve:
    u = tuple(element.number(f"{name}U", 0.0) for name in "abcd")
    v = tuple(element.number(f"{name}V", 0.0) for name in "abcd")
    if not any(u[1:]) and not any(v[1:]):
        raise element.fault("all its polynomials are constant, so that it has no direction")
    unit = element.text("pRange", "normalized")
    if unit not in ("normalized", "arcLength"):
        raise element.fault(f"pRange is {unit[:40]!r}, neither normalized nor arcLength")
    return ParamPoly3(u, v, 1.0 if unit == "arcLength" else 1 / length)  # pyright: ignore[reportArgumentType]


def _curvature(element: Element, name: str, length: float) -> float:
    value = element.number(name, most=_MAX_CURVATURE)
    if abs(value) * length > MAX_TURN:
        raise element.fault(f"{name} is {value:g} over {length:g} m, more than {MAX_TURN:g} rad")
    return value


_READERS: dict[str, Callable[[Element, float], Curve]] = {
    "line": _read_line,
    "arc": _read_arc,
    "spiral": _read_spiral,
    "poly3": _read_poly3,
    "paramPoly3": _read_param_poly3,
}
