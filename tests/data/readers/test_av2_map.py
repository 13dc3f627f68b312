"""Map archives of Argoverse 2."""

from __future__ import annotations

import json

import numpy as np
import pytest

from scjax.data.readers.av2_map import read_av2_map
from scjax.data.readers.bounds import middle_line
from scjax.scene import LaneNeighbor
from tests.factories.map_files import av2_map


def _read(tmp_path, content):
    path = tmp_path / "log_map_archive_abc____PIT_city_1.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return read_av2_map(path)


def test_read_av2_map_reads_lane_segments(tmp_path):
    log = _read(tmp_path, av2_map())
    first, second, third = log.lanes
    np.testing.assert_allclose(first.points, [[0, 0, 1], [30, 0, 1]])
    assert first.successors == ("2",) and second.predecessors == ("1",) and third.lane_type == "bike_lane"
    assert first.right_neighbors == (LaneNeighbor("3"),) and second.left_neighbors == ()  # lane 99 is not there
    assert log.metadata.scene_id == "abc" and log.num_objects == 0


def test_middle_line_keeps_the_points_of_both_bounds():
    left = np.array([[0.0, 2, 0], [10, 2, 0], [20, 2, 4]])
    right = np.array([[0.0, 0, 0], [5, 0, np.nan], [20, 0, np.nan]])
    line = middle_line(left, right)
    np.testing.assert_allclose(line[:, :2], [[0, 1], [5, 1], [10, 1], [20, 1]])
    assert np.isnan(line[2:, 2]).all()
    point = np.zeros((2, 3))
    np.testing.assert_allclose(middle_line(point, right[[0, 2]])[:, 0], [0, 10])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "no JSON"),
        ({"lane_segments": {}}, "has no lane_segments"),
        ({"drivable_areas": {}}, "missing required field `lane_segments`"),
        ({"lane_segments": {"1": {"id": 1}}}, r"lane_segments\[...\]: .*left_lane_boundary"),
        (av2_map(lane_segments={**av2_map()["lane_segments"], "4": av2_map()["lane_segments"]["1"]}), "the same id"),
        (json.dumps(av2_map()).replace('"x": 30', '"x": 1e99'), "lane 1 has NaN or absurd coordinates"),
        (json.dumps(av2_map()).replace('"x": 30', '"x": "far"'), "expected `float`"),
    ],
)
def test_damaged_archives_are_refused(content, message, tmp_path):
    with pytest.raises(ValueError, match=message) as error:
        _read(tmp_path, content)
    assert str(error.value).startswith(str(tmp_path))
