"""Maps in files: round trips, and complaints that name the file."""

from __future__ import annotations

import json

import numpy as np
import pytest

from scjax.scene import Map, load_map, save_map
from tests.factories.maps import two_tile_map

MAPS = {"two tiles": two_tile_map, "nothing": lambda: Map(lanes=())}


def assert_same_map(one: Map, other: Map, tolerance: float = 0.0) -> None:
    for name in ("signal_states", "signal_positions", "agent_types", "agents"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=tolerance, err_msg=name)
    for name in ("has_topology", "signal_lane_ids", "agent_ids", "tiles", "seams", "routes", "metadata"):
        assert getattr(one, name) == getattr(other, name), name
    for lane, same in zip(one.lanes, other.lanes, strict=True):
        np.testing.assert_allclose(lane.points, same.points, rtol=0, atol=tolerance)
        assert {**vars(lane), "points": 0} == {**vars(same), "points": 0}


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize(("ending", "tolerance"), [(".npz", 0.0), (".json", 1e-6)])
def test_map_round_trip(name, ending, tolerance, tmp_path):
    map, path = MAPS[name](), tmp_path / "new" / f"map{ending}"
    save_map(map, path)
    assert_same_map(load_map(path), map, tolerance)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_map_by_hand_needs_lanes_only(tmp_path):
    path = tmp_path / "map.json"
    lane = {"id": "a", "points": [[0, 0], [10, 0]], "left_neighbors": [["b"]]}
    path.write_text(json.dumps({"format": "scjax-map", "version": 1, "lanes": [lane], "signals": [{"lane_id": "a"}]}))
    map = load_map(path)
    assert map.lanes[0].left_neighbors[0].lane_id == "b" and np.isnan(map.lanes[0].points[:, 2]).all()
    assert np.isnan(map.signal_positions).all()


def test_save_map_refuses_invalid_maps_and_names(tmp_path):
    with pytest.raises(ValueError, match="tile 0 names"):
        save_map(two_tile_map(lanes=()), tmp_path / "map.npz")
    with pytest.raises(ValueError, match=r"map\.txt: maps are written to"):
        save_map(two_tile_map(), tmp_path / "map.txt")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", [".npz", ".json"])
@pytest.mark.parametrize("size", [0, 10, -30])
def test_load_map_names_a_truncated_file(ending, size, tmp_path):
    path = tmp_path / f"short{ending}"
    save_map(two_tile_map(), path)
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(ValueError, match=f"short{ending}"):
        load_map(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, "is no map"),
        ({"version": 2}, "format version 2, this scjax reads 1"),
        ({"lanes": [{"id": "a"}]}, r"lanes\[0\]: .*points"),
        ({"lanes": [{"id": "a", "points": [[0]]}]}, r"points\[0\]"),
        ({"lanes": [{"id": "a", "points": [[0, None]]}]}, "lane a has NaN"),
        ({"agents": [{"id": "1", "type": "tank", "x": 0, "y": 0, "heading": 0}]}, r"agents\[0\].type"),
        ({"tiles": [{"x": 0, "y": 0, "status": "splendid"}]}, r"tiles\[0\].status"),
        ({"roads": []}, "roads"),
    ],
)
def test_load_map_names_the_field(changes, message, tmp_path):
    path = tmp_path / "map.json"
    path.write_text(json.dumps({"format": "scjax-map", "version": 1, "lanes": []} | changes))
    with pytest.raises(ValueError, match=message) as error:
        load_map(path)
    assert str(error.value).startswith(str(path))


@pytest.mark.parametrize(("name", "array"), [("agents", np.zeros(4)), ("lane_offsets", np.zeros(9, int))])
def test_load_map_refuses_arrays_that_do_not_fit(name, array, tmp_path):
    path = tmp_path / "map.npz"
    save_map(two_tile_map(), path)
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **(arrays | {name: array}))
    with pytest.raises(ValueError, match="invalid map"):
        load_map(path)
