import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.data.readers.opendrive.curves import Arc, Line, ParamPoly3, Poly3, Spiral
from scjax.data.readers.opendrive.plan_view import read_plan_view
from tests.factories import opendrive_files as files

curvatures = st.floats(-0.2, 0.2)
lengths = st.floats(0.01, 200.0)


def _integrated(curvature, length: float, places: np.ndarray) -> np.ndarray:
    """Poses by the trapezoid rule on a fine grid: an integration of another kind."""
    s = np.linspace(0, length, 200_001)
    step = s[1]
    heading = np.concatenate([[0.0], np.cumsum((curvature(s[1:]) + curvature(s[:-1])) / 2) * step])
    columns = [heading]
    for values in (np.sin(heading), np.cos(heading)):
        columns.insert(0, np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2) * step]))
    return np.stack([np.interp(places, s, column) for column in columns], -1)


@given(curvatures, curvatures, lengths)
@settings(max_examples=25, deadline=None)
def test_spiral_is_the_integral_of_its_curvature(start, end, length):
    places = np.linspace(0, length, 7)
    expected = _integrated(lambda s: start + (end - start) * s / length, length, places)
    np.testing.assert_allclose(Spiral(start, end, length).poses(places), expected, atol=1e-6)


@given(curvatures, lengths)
@settings(max_examples=25, deadline=None)
def test_spiral_of_constant_curvature_is_an_arc(curvature, length):
    places = np.linspace(0, length, 9)
    np.testing.assert_allclose(
        Spiral(curvature, curvature, length).poses(places), Arc(curvature).poses(places), atol=1e-9
    )


@given(st.floats(1e-3, 1.0), lengths)
def test_arc_keeps_its_distance_from_the_center(curvature, length):
    u, v, heading = Arc(curvature).poses(np.linspace(0, length, 9)).T
    np.testing.assert_allclose(np.hypot(u, v - 1 / curvature), 1 / curvature, rtol=1e-9)
    np.testing.assert_allclose(heading, curvature * np.linspace(0, length, 9))


def test_arc_without_curvature_is_a_line():
    places = np.linspace(0, 50, 6)
    np.testing.assert_allclose(Arc(0.0).poses(places), Line().poses(places))


@given(st.floats(-0.5, 0.5), st.floats(-0.02, 0.02), st.floats(-2e-4, 2e-4), st.floats(1.0, 80.0))
@settings(max_examples=25, deadline=None)
def test_poly3_has_the_arc_length_of_its_places(b, c, d, length):
    curve = Poly3((0.3, b, c, d), length)
    places = np.linspace(0, length, 4001)
    u, v, heading = curve.poses(places).T
    np.testing.assert_allclose(v, 0.3 + u * (b + u * (c + u * d)), atol=1e-9)
    np.testing.assert_allclose(np.tan(heading), b + u * (2 * c + 3 * d * u), atol=1e-6)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(u), np.diff(v)))])
    np.testing.assert_allclose(arc, places, atol=1e-3 + 1e-5 * length)


def test_param_poly3_reads_both_ranges():
    # The same parabola u = 20 p, v = 5 p², once with p from 0 to 1 and once with p as a length of 20 m.
    shape = '<paramPoly3 aU="0" bU="{}" cU="0" dU="0" aV="0" bV="0" cV="{}" dV="0" pRange="{}"/>'
    plans = [
        read_plan_view(_road(files.geometry(shape.format(*values), 20.0)))
        for values in ((20.0, 5.0, "normalized"), (1.0, 5 / 400, "arcLength"))
    ]
    s = np.linspace(0, 20, 5)
    for plan in plans:
        poses = plan.poses(s, s)
        np.testing.assert_allclose(poses[:, :2], np.stack([s, 5 * (s / 20) ** 2], -1))
        np.testing.assert_allclose(np.tan(poses[:, 2]), s / 40)


def test_param_poly3_without_a_range_is_normalized():
    curve = read_plan_view(_road(files.geometry('<paramPoly3 bU="20"/>', 20.0))).curves[0]
    assert isinstance(curve, ParamPoly3) and curve.scale == 1 / 20


def test_plan_view_places_each_curve_by_its_own_pose():
    plan = read_plan_view(
        _road(
            files.geometry(length=10, x=3, y=4, heading=np.pi / 2)
            + files.geometry('<arc curvature="0.1"/>', 10, s=10, x=3, y=14, heading=np.pi / 2)
        )
    )
    poses = plan.poses(np.array([5.0, 10.0, 20.0]), np.array([5.0, 9.0, 19.0]))
    np.testing.assert_allclose(poses[:2], [[3, 9, np.pi / 2], [3, 14, np.pi / 2]])
    np.testing.assert_allclose(poses[2], [3 - 10 * (1 - np.cos(1)), 14 + 10 * np.sin(1), np.pi / 2 + 1])


@pytest.mark.parametrize(
    ("shape", "word"),
    [
        ("<nurbs/>", "holds none of line, arc"),
        ('<arc curvature="x"/>', "curvature is 'x'"),
        ("<arc/>", "has no curvature"),
        ('<arc curvature="nan"/>', "curvature is nan"),
        ('<arc curvature="50"/>', "more than 100 rad"),
        ('<spiral curvStart="0" curvEnd="1e300"/>', "curvEnd is 1e[+]300"),
        ('<paramPoly3 pRange="meters" bU="1"/>', "pRange is 'meters'"),
        ("<paramPoly3/>", "constant"),
    ],
)
def test_curve_that_is_no_curve_is_refused(shape, word):
    with pytest.raises(ValueError, match=f"line 2.*{word}"):
        read_plan_view(_road(files.geometry(shape)))


def _road(plan: str):
    element = files.root(files.road(plan=plan)).first("road")
    assert element is not None
    return element
