import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scjax.data.readers.opendrive.lane_lines import LaneLine, sample_section
from scjax.data.readers.opendrive.road_map import build_road_map
from scjax.data.readers.opendrive.roads import read_road
from tests.factories import opendrive_files as files
from tests.factories.opendrive_files import cubic, geometry, lane, road, section


def _lines(*sections: str, **options) -> dict[tuple[int, int], LaneLine]:
    """Centerlines of one road by (section, lane)."""
    lines = build_road_map(files.root(road("1", *sections, **options))).lines
    return {key[1:]: line for key, line in lines.items()}


def test_lanes_lie_beside_the_reference_line_in_driving_direction():
    lines = _lines(section(lane(2, width=3.0), lane(1), lane(-1)))
    for number, y, direction in ((2, 5.0, -1), (1, 1.75, -1), (-1, -1.75, 1)):
        points = lines[0, number].points
        np.testing.assert_allclose(points[:, 1], y)
        assert np.sign(points[-1, 0] - points[0, 0]) == direction and set(points[[0, -1], 0]) == {0.0, 100.0}


def test_left_hand_traffic_drives_the_other_way():
    lines = _lines(more='rule="LHT"')
    assert lines[0, 1].points[0, 0] == 0 and lines[0, -1].points[0, 0] == 100


def test_reversed_lane_drives_against_its_side():
    lines = _lines(section(lane(-1, more='direction="reversed"')))
    assert lines[0, -1].points[0, 0] == 100


def test_width_that_changes_moves_the_center():
    widths = cubic("width", 3.0, start="sOffset") + cubic("width", 3.0, 0.02, s=50, start="sOffset")
    points = _lines(section(lane(-1, width=widths), lane(-2, width=2.0)))
    assert np.interp(100, *points[0, -1].points[:, :2].T) == pytest.approx(-2.0)
    for x, y in ((0, -4.0), (50, -4.0), (75, -4.5), (100, -5.0)):
        assert np.interp(x, *points[0, -2].points[:, :2].T) == pytest.approx(y, abs=0.005)


@pytest.mark.parametrize("sign", [-1, 1], ids=["t-coordinate", "distance"])
def test_borders_stand_for_widths(sign):
    border = cubic("border", sign * 4.0, start="sOffset")
    lines = _lines(section(lane(-1), lane(-2, width=border)))
    np.testing.assert_allclose(lines[0, -2].points[:, 1], -3.75)
    np.testing.assert_allclose(lines[0, -2].widths, 0.5)


def test_lane_offset_moves_all_lanes():
    offset = cubic("laneOffset", 1.0, s=40) + cubic("laneOffset", 1.0, 0.1, s=60)
    points = _lines(offset=offset)[0, -1].points
    assert points[0, 1] == pytest.approx(-1.75) and points[-1, 1] == pytest.approx(-1.75 + 5)


def test_elevation_and_superelevation_give_heights():
    lines = _lines(elevation=cubic("elevation", 5.0, 0.01), lateral=cubic("superelevation", 0.1))
    for number, t in ((1, 1.75), (-1, -1.75)):
        points = lines[0, number].points
        np.testing.assert_allclose(points[:, 1], t * np.cos(0.1))
        np.testing.assert_allclose(points[:, 2], 5 + 0.01 * points[:, 0] + t * np.sin(0.1), atol=1e-9)


def test_lanes_without_width_are_no_lanes():
    assert set(_lines(section(lane(-1), lane(-2, width=0.0), lane(-3, width=0.05)))) == {(0, -1)}


def test_section_of_one_side_leaves_the_other_side_as_it_was():
    sections = (section(lane(1), lane(-1)), section(lane(-1), s=50, more='singleSide="true"'))
    lines = _lines(*sections)
    assert set(lines) == {(0, 1), (0, -1), (1, -1)}
    assert lines[0, 1].length == pytest.approx(100) and lines[1, -1].length == pytest.approx(50)


def test_step_of_a_width_is_drawn_out():
    widths = cubic("width", 3.5, start="sOffset") + cubic("width", 3.0, s=50, start="sOffset")
    points = _lines(section(lane(-1, width=widths), lane(-2)))[0, -2].points
    assert points[0, 1] == pytest.approx(-5.25) and points[-1, 1] == pytest.approx(-4.75)
    headings = np.arctan2(*np.diff(points[:, :2], axis=0).T[::-1])
    assert np.abs(np.diff(headings)).max() < np.deg2rad(3)


def test_huge_polynomial_of_a_micrometer_does_no_harm():
    widths = cubic("width", 3.5, start="sOffset") + cubic("width", 3.5, 0, -1e13, 1e18, s=50, start="sOffset")
    widths += cubic("width", 3.5, s=50.000001, start="sOffset")
    np.testing.assert_allclose(_lines(section(lane(-1, width=widths)))[0, -1].points[:, 1], -1.75, atol=1e-6)


shapes = st.one_of(
    st.builds('<arc curvature="{}"/>'.format, st.floats(-0.12, 0.12)),
    st.builds('<spiral curvStart="{}" curvEnd="{}"/>'.format, st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
    st.builds('<poly3 a="0" b="{}" c="{}" d="0"/>'.format, st.floats(-0.3, 0.3), st.floats(-0.01, 0.01)),
    st.builds('<paramPoly3 bU="40" cV="{}" dV="{}"/>'.format, st.floats(-20, 20), st.floats(-10, 10)),
)


@given(shapes, st.floats(-0.002, 0.002), st.floats(-1e-3, 1e-3))
@settings(max_examples=40, deadline=None)
def test_chords_stay_within_centimeters_of_the_center(shape, bend, width_change):
    """The centerline is known at every place: t of the center along the normal of the reference line."""
    width = cubic("width", 3.5, 0.02, width_change, start="sOffset")
    text = road("1", section(lane(-1, width=width)), plan=geometry(shape, 40.0), length=40.0,
                elevation=cubic("elevation", 0, 0.01, bend))  # fmt: skip
    element = files.root(text).first("road")
    assert element is not None
    parsed = read_road(element)
    (line,) = sample_section(parsed, 0, parsed.sides[1][0])
    s = np.linspace(0, 40, 2001)
    x, y, heading = parsed.plan_view.poses(s, s).T
    t = -(3.5 + 0.02 * s + width_change * s * s) / 2
    exact = np.stack([x - t * np.sin(heading), y + t * np.cos(heading), 0.01 * s + bend * s * s], -1)
    chords = np.diff(line.points, axis=0)
    offset = exact[:, None] - line.points[None, :-1]
    share = np.clip((offset * chords).sum(-1) / (chords**2).sum(-1), 0, 1)
    distance = np.linalg.norm(offset - share[..., None] * chords, axis=-1).min(1)
    assert distance.max() < 0.03
    np.testing.assert_allclose(line.points[[0, -1]], exact[[0, -1]], atol=1e-6)
    turns = np.diff(np.unwrap(np.arctan2(chords[:, 1], chords[:, 0])))
    assert np.abs(turns).max() < np.deg2rad(6)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"length": 0.0, "plan": geometry()}, "length is 0"),
        ({"elevation": cubic("elevation", 1e9)}, "NaN or absurd coordinates"),
        ({"elevation": '<elevation s="0" a="inf"/>'}, "a is inf"),
        ({"plan": geometry(x=2e7)}, "x is 2e[+]07"),
        ({"plan": geometry(length=-3.0)}, "must not be negative"),
        ({"plan": "<geometry/>"}, "has no length"),
        ({"links": files.follows("successor", "2", "middle")}, "contactPoint is 'middle'"),
        ({"more": 'rule="left"'}, "rule is 'left'"),
    ],
)
def test_road_with_a_fault_is_refused(change, word):
    with pytest.raises(ValueError, match=f"line 2, <.*{word}"):
        build_road_map(files.root(road(**change)))


@pytest.mark.parametrize(
    ("lanes", "word"),
    [
        ("", "has no <lanes>"),
        ('<laneSection s="0"><right><lane id="1"/></right></laneSection>', "lane 1 cannot lie on the right"),
        ('<laneSection s="0"><right><lane id="one"/></right></laneSection>', "id is 'one', not a whole number"),
        ('<laneSection s="0"><right><lane id="-1"/><lane id="-1"/></right></laneSection>', "two lanes"),
        ('<laneSection><right><lane id="-1"/></right></laneSection>', "has no s"),
    ],
)
def test_lanes_with_a_fault_are_refused(lanes, word):
    text = f'<road id="1" length="9"><planView>{geometry(length=9)}</planView><lanes>{lanes}</lanes></road>'
    with pytest.raises(ValueError, match=word):
        build_road_map(files.root(text))
