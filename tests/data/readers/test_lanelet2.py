"""Lanelet2 files: directions, connections, projection, and damage."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.data.readers.lanelet2 import read_lanelet2
from scjax.data.readers.lanelet2.projection import project_degrees
from scjax.scene import LaneNeighbor
from tests.factories.map_files import lanelet2


def _read(tmp_path, text: str):
    path = tmp_path / "map.osm"
    path.write_text(text)
    return read_lanelet2(path)


@pytest.mark.parametrize("in_degrees", [False, True])
def test_read_lanelet2_finds_directions_and_connections(in_degrees, tmp_path):
    log = _read(tmp_path, lanelet2(in_degrees))
    lanes = {lane.id: lane for lane in log.lanes}
    assert lanes["11"].successors == ("12",) and lanes["12"].predecessors == ("11",)
    assert lanes["11"].right_neighbors == (LaneNeighbor("13", 0, 1, 0, 1),) and not lanes["11"].left_neighbors
    assert lanes["13"].left_neighbors == (LaneNeighbor("11", 0, 1, 0, 1),)
    assert {name: lane.lane_type for name, lane in lanes.items()} == {
        "11": "surface_street",
        "12": "surface_street",
        "13": "surface_street",
        "14": "not_for_cars",
    }
    points = lanes["11"].points
    np.testing.assert_allclose(points[1, :2] - points[0, :2], [20, 0], atol=0.02)
    assert log.signal_lane_ids == ("12",)
    np.testing.assert_allclose(log.signal_positions[0, :2], points[1, :2])
    if not in_degrees:
        np.testing.assert_allclose(points, [[0, 1.5, 5], [20, 1.5, 5]])
        assert log.metadata.variant == "lanelet2 in meters"


def test_lanelets_for_both_directions_are_counted(tmp_path):
    assert _read(tmp_path, lanelet2(one_way="no")).metadata.notes == {"lanelets for both directions, read in one": 3}


def test_explicit_center_lines_are_taken(tmp_path):
    member = '<relation id="12"><member type="way" role="centerline" ref="24"/>'
    lanes = {lane.id: lane for lane in _read(tmp_path, lanelet2().replace('<relation id="12">', member)).lanes}
    np.testing.assert_allclose(lanes["12"].points[:, 1], 0.0)


def test_projection_has_the_lengths_of_the_ellipsoid():
    # WGS 84: the meridian from the equator to 45 degrees is 4984944.378 m long.
    np.testing.assert_allclose(
        project_degrees(np.array([45.0]), np.zeros(1), (0.0, 0.0))[0, 1], 4984944.378, atol=0.002
    )
    sine2, step = np.sin(np.deg2rad(49.0)) ** 2, np.deg2rad(0.001)
    radius = 6378137.0 / np.sqrt(1 - 0.00669438 * sine2)
    east = project_degrees(np.full(1, 49.0), np.full(1, 8.401), (49.0, 8.4))[0]
    np.testing.assert_allclose(east, [radius * np.cos(np.deg2rad(49.0)) * step, 0], atol=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('v="lanelet"', 'v="multipolygon"', "no relation of type lanelet"),
        ('role="left" ref="21"', 'role="left" ref="99"', "its left bound, way '99', is not in the file"),
        ('role="left" ref="21"', 'role="other" ref="21"', "has no left bound"),
        ('<nd ref="1"/>', '<nd ref="77"/>', "its node '77' is not in the file"),
        ('<nd ref="1"/>', "", "its left bound has 1 nodes"),
        ('k="local_x" v="0"', 'k="local_x" v="here"', "its tag local_x is 'here', not a number"),
        ('k="local_x" v="0"', 'k="local_x" v="1e99"', "its tag local_x is '1e99': it must be finite"),
        ('<tag k="local_x" v="0"/>', "", "lat is '', not a number"),
        ('<way id="22">', '<way id="21">', "another way has the same id"),
        ('v="road"', 'v="walkway"', "no lanelet that cars may use"),
        ("</osm>", "", "no sound XML"),
        ("<osm version='0.6'>", "<!DOCTYPE x [<!ENTITY a 'b'>]><osm>", "defines the entity 'a'"),
    ],
)
def test_damaged_maps_are_refused_in_one_line(old, new, message, tmp_path):
    assert old in lanelet2()
    with pytest.raises(ValueError, match=message) as error:
        _read(tmp_path, lanelet2().replace(old, new))
    assert str(error.value).startswith(str(tmp_path / "map.osm")) and "\n" not in str(error.value)


def test_places_far_from_the_map_are_refused(tmp_path):
    with pytest.raises(ValueError, match="more than 200 km from the middle"):
        _read(tmp_path, lanelet2(in_degrees=True).replace('lat="49.0', 'lat="-9.0', 1))
