"""Maps from the model that ships: what stays, what meets, and what is refused."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import scjax
from scjax.generate.lane_places import along_lanes
from scjax.generate.outline_draw import draw_outline
from scjax.generate.scene_spec import specify_scene
from scjax.outpainting.dead_turns import DeadTurns
from scjax.outpainting.outpaint import outpaint_steps
from scjax.outpainting.tile_candidate import tile_candidate
from scjax.outpainting.window import KnownWindow, WindowPose, cut_window
from scjax.scene import Crop, TileStatus, measure_seam, save_map
from scjax.scene.io import save_npz
from tests.factories.maps import two_tile_map

FEW = {"candidates": 2, "retries": 0}


@pytest.fixture(scope="module")
def grown():
    return scjax.extend_map(0, two_tile_map(), x=95.5, y=-2.0, yaw=0.0, **FEW)


def test_what_is_there_stays_and_new_lanes_meet_it(grown):
    scjax.validate_map(grown)
    for name, lane in two_tile_map().lane_by_id.items():
        kept = grown.lane_by_id[name].points
        moved = np.abs(kept - lane.points).max()
        assert moved <= 0.5 + 1e-9, name  # the part beyond the seam is cut off
    tile = grown.tiles[-1]
    assert tile.status in (TileStatus.COMPLETE, TileStatus.INCOMPLETE) and tile.attempts == 2
    assert len(tile.lane_ids) == grown.num_lanes - 4
    seam = grown.seams[-1]
    assert seam.tiles == (1, 2) and seam.connections
    measures = measure_seam(grown, seam)
    assert measures.gaps.max() == 0.0 and np.rad2deg(measures.turns.max()) < 5.0


def test_new_agents_overlap_nobody(grown):
    from scjax.scene.boxes import overlaps

    boxes = grown.agents[~np.isnan(grown.agents[:, 6:8]).any(-1)]
    assert not np.any(overlaps(boxes))


def test_the_same_key_gives_the_same_map(grown):
    again = scjax.extend_map(0, two_tile_map(), x=95.5, y=-2.0, yaw=0.0, **FEW)
    assert [lane.id for lane in again.lanes] == [lane.id for lane in grown.lanes]
    assert all(np.array_equal(a.points, b.points) for a, b in zip(again.lanes, grown.lanes, strict=True))


def test_maps_grow_step_by_step_along_a_route():
    maps = list(outpaint_steps(1, two_tile_map(), length=150.0, max_tiles=1, **FEW))
    assert maps[0].num_lanes == 4 and len(maps[-1].tiles) == 3
    assert maps[-1].routes[0].lane_ids[:2] == ("ahead-0", "ahead-1")


def test_routes_that_are_long_enough_need_no_tile():
    maps = list(outpaint_steps(0, two_tile_map(), length=100.0))
    assert len(maps[-1].tiles) == 2 and maps[-1].routes[0].lane_ids == ("ahead-0", "ahead-1")


def test_new_vehicles_keep_to_the_lanes_that_they_are_meant_for():
    model = scjax.load()
    known = cut_window(two_tile_map(), WindowPose(95.5, -2.0, 0.0, 0.0))
    spec = specify_scene(scjax.Condition(known=known, crop=Crop.PARTITIONED), {}, model)
    outlines = [draw_outline(np.random.default_rng(seed), spec, model) for seed in range(8)]
    count = len(known.agent_mask)
    for outline in outlines:
        assert outline is not None and outline.along is not None
        assert outline.along.shape == outline.agents.shape and not outline.along[:count].any()
        assert np.array_equal(outline.along[count:], along_lanes(outline.agents[count:], model.codec))
    assert any(outline.along.any() for outline in outlines)


def test_a_window_without_continuation_changes_nothing_but_the_tiles():
    map = two_tile_map()
    pose = WindowPose(95.5, -2.0, 0.0, 0.0)
    known = cut_window(map, pose)
    from scjax.outpainting.coverage import Coverage

    window = KnownWindow(pose, map, known, (), DeadTurns(map, (), 0.0, 0.0))
    candidate = tile_candidate(known, window, Coverage(map), "2")
    assert candidate.map.num_lanes == 0 and candidate.connections == () and candidate.map.num_agents == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": two_tile_map(), "length": 100.0, "area": (0.0, 1.0, 0.0, 1.0)}, "length and area"),
        ({"start": two_tile_map(), "route": "left"}, "route is 'left'"),
        ({"start": two_tile_map(), "route": [(0.0, 0.0)]}, "at least two points"),
        ({"start": two_tile_map(), "area": (1.0, 0.0, 0.0, 1.0)}, "x_min < x_max"),
        ({"start": two_tile_map(), "candidates": 0}, "candidates"),
        ({"start": two_tile_map(), "at": (0.0, 500.0, 0.0)}, "no lane leads on"),
        ({"start": dataclasses.replace(two_tile_map(), tiles=(), seams=(), routes=())}, "at is missing"),
        ({"start": two_tile_map(), "condition": scjax.Condition(num_lanes=3)}, "Condition.num_lanes"),
        ({"start": two_tile_map(), "condition": []}, "condition must be"),
    ],
)
def test_bad_input_names_the_argument(options, message):
    with pytest.raises(ValueError, match=message):
        list(outpaint_steps(0, options.pop("start"), options.pop("condition", None), **{"max_tiles": 1, **options}))


def test_the_command_writes_a_map_and_its_picture(run, tmp_path):
    save_map(two_tile_map(), tmp_path / "start.json")
    code, out, err = run("outpaint", "--start", "start.json", "--length", "100", "--out", "grown.json", "--json")
    assert code == 0, err
    assert json.loads(out)["files"] == ["grown.json", "grown.png"] and json.loads(out)["tiles"] == []
    assert scjax.load_map(tmp_path / "grown.json").routes[0].name == "outpainted"
    assert (tmp_path / "grown.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--out", "map.png"], 2, "maps are .npz or .json"),
        (["--length", "9", "--area", "0,1,0,1"], 2, "exclude each other"),
        (["--at", "1,2"], 2, "give 3 numbers"),
        (["--start", "nothing.npz"], 1, "nothing.npz"),
        (["--start", "start.json", "--at", "0,500,0"], 1, "no lane leads on"),
    ],
)
def test_the_command_says_what_is_wrong_in_one_line(arguments, code, message, run, tmp_path):
    save_map(two_tile_map(), tmp_path / "start.json")
    actual, _, err = run("outpaint", *arguments)
    assert (actual, message in err) == (code, True), err
    assert code == 2 or len(err.splitlines()) == 1


@pytest.fixture(scope="module")
def forward():
    """What a camera sees of a straight street."""
    map = two_tile_map()
    return scjax.crop_map(map, 20.0, -2.0, crop=Crop.FORWARD)


def test_what_is_behind_a_forward_scene_meets_it_and_all_of_it_stays(forward):
    map = scjax.complete_rear(0, forward, **FEW)
    scjax.validate_map(map)
    count = forward.num_lanes
    lines = np.asarray(forward.lanes, np.float64)
    assert all(np.array_equal(map.lane_by_id[f"0.lane-{row}"].points, lines[row]) for row in range(count))
    assert map.tiles[1].status in (TileStatus.COMPLETE, TileStatus.INCOMPLETE) and abs(map.tiles[1].yaw) > 3.1
    new = map.tiles[1].lane_ids
    behind = np.concatenate([map.lane_by_id[name].points for name in new])
    assert behind[:, 0].max() < 1.0 and behind[:, 0].min() < -20.0
    own, oncoming = (
        {pair for pair in map.seams[0].connections if pair[0 if ahead else 1] in new} for ahead in (True, False)
    )
    assert own and oncoming, "the same side of the road is driven on behind the ego"


def test_only_forward_scenes_have_a_rear_to_complete(forward):
    with pytest.raises(ValueError, match="not cut forward"):
        scjax.complete_rear(0, scjax.crop_map(two_tile_map(), 0.0, -2.0))


def test_the_command_completes_the_rear(run, tmp_path, forward):
    save_npz(forward, tmp_path / "forward.npz")
    options = ("--candidates", "2", "--retries", "0", "--json")
    code, out, err = run("outpaint", "--start", "forward.npz", "--rear", *options)
    assert code == 0, err
    assert len(json.loads(out)["tiles"]) == 1
    code, _, err = run("outpaint", "--rear")
    assert code == 2 and "--rear goes with --start" in err
    save_map(two_tile_map(), tmp_path / "start.json")
    code, _, err = run("outpaint", "--start", "start.json", "--rear")
    assert code == 1 and "--rear takes a forward scene" in err
