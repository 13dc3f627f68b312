"""Studies of maps on maps that are there already: what the pages say of them."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from experiments.studies import imported_maps, map_tiles, maps, rear
from scjax.scene import MapTile, TileStatus, save_map
from tests.factories.maps import street_grid, two_tile_map


def test_the_page_of_maps_counts_tiles_seams_and_ends(tmp_path):
    for seed in range(2):
        save_map(two_tile_map(), tmp_path / f"{seed}.npz")
        (tmp_path / f"{seed}.json").write_text(json.dumps({"seconds": 9.0}))
    maps.main(["--maps", "2", "--length", "30", "--keep", str(tmp_path), "--out", str(tmp_path / "page")])
    text = (tmp_path / "page.md").read_text()
    for line in (
        "| routes of 30 m | 2 of 2 |",
        "| tiles that are complete | 0 of 2 |",
        "| connections at seams | 4 |",
        "| gaps, largest [m] | 0.000 |",
        "| dead ends for each km of lane | 0.00 |",
        "| lane ends that are dead | 0.00 % | 0.00 % |",
    ):
        assert line in text
    assert json.loads((tmp_path / "page.json").read_text())["tiles"] == [1, 1]


def test_windows_show_the_new_half_of_tiles_on_covered_ground():
    map = two_tile_map()
    assert list(map_tiles.windows(map)) == [], "the road reaches into that window from the border of the map"
    longer = street_grid(300.0)
    tile = MapTile(x=100.0, y=150.0, status=TileStatus.COMPLETE)
    ((shown, scene),) = map_tiles.windows(dataclasses.replace(longer, tiles=(tile,)))
    assert shown == tile and scene.num_lanes >= 2 and float(scene.agents[0, 4]) == pytest.approx(1.0)


def test_the_page_of_tiles_has_a_column_for_each_set():
    lines = [{"id": "t1", "prompt": "a crossing"}, {"id": "t2", "prompt": "a bus"}]
    one = {
        "styles": {"t1": (3, 4), "t2": (0, 4)},
        "prompts": (3, 8),
        "faults": {name: (1, 8) for name in map_tiles.FAULTS},
    }
    text = map_tiles.page({"maps": one, "single": one}, lines, "command")
    assert "| a crossing | 3 of 4 (75 %) | 3 of 4 (75 %) |" in text and "| overlapping boxes | 12.5 | 12.5 |" in text


def test_imported_maps_grow_where_least_is_covered():
    pose = imported_maps.open_place(two_tile_map())
    assert pose is not None and (pose.x, round(float(np.cos(pose.yaw)))) in ((95.5, 1), (-31.5, -1))
    rows = [{"file": "a.xodr", "lanes": 4, "tile": "complete", "fault": "", "connections": 2, "turn": 0.4, "agents": 8}]
    assert "1 of 1 tiles are complete; 0 maps have no open end." in imported_maps.page(rows, "command")


def test_the_page_of_rears_counts_both_kinds_of_roads():
    rows = [
        {"back": True, "status": "complete", "fault": ""},
        {"back": False, "status": "incomplete", "fault": "1 lane"},
    ]
    text = rear.page(rows, "command")
    assert "| a lane leads back beside the ego | 1 | 1 | 0 | 0 |" in text
    assert "| no lane leads back, such as on one-way roads | 1 | 0 | 1 | 0 |" in text
