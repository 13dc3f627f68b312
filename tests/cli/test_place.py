"""scjax place and scjax edit: what they write, and how they refuse."""

from __future__ import annotations

import json

import numpy as np
import pytest

import scjax
from scjax.scene import load_map, save_log, save_map
from scjax.scene.io import load_json, save_npz
from tests.factories.examples import example_batch
from tests.factories.logs import example_log
from tests.factories.maps import two_tile_map
from tests.factories.traffic import agent, lane, scene
from tests.factories.worlds import tiny_model

STREET = scene(
    [agent(0, 0), agent(12, 0), agent(-12, 0), agent(20, 4, 180)],
    [lane((-30, 0), (30, 0)), lane((30, 4), (-30, 4))],
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return scjax.save(tiny_model(), tmp_path_factory.mktemp("place") / "model")


@pytest.fixture
def files(tmp_path):
    save_npz(STREET, tmp_path / "street.npz")
    save_npz(example_batch(2), tmp_path / "two.npz")
    save_map(two_tile_map(), tmp_path / "map.json")
    save_log(example_log(), tmp_path / "log.npz")


def options(folder):
    return ["--model", folder, "--num-steps", 2]


def test_place_writes_scenes_and_the_map(run, folder, files, tmp_path):
    more = ["--agents", 4, "--best-of", 1, "--json", "--map-out", "town.json", "--seed", 3]
    code, out, _ = run("place", "map.json", "--at", "20,-2,90", *more, *options(folder))
    assert code == 0
    (result,) = json.loads(out)["scenes"]
    assert result["files"] == ["map-3-0.png", "map-3-0.json", "town.json"] and result["agents"] == 4
    assert load_map(tmp_path / "town.json").num_agents == load_json(tmp_path / "map-3-0.json").num_agents


def test_place_keeps_the_lanes_of_every_scene(run, folder, files, tmp_path):
    code, out, err = run("place", "two.npz", "-n", 2, "--best-of", 1, "--format", "json", *options(folder))
    assert code == 0 and "4 scenes" in err
    placed = [load_json(tmp_path / name) for name in out.split()]
    for number, one in enumerate(placed):
        lanes = example_batch(2).lanes[number % 2, : int(one.num_lanes)]
        np.testing.assert_allclose(one.lanes, lanes, atol=1e-5)


def test_edit_names_agents_as_the_file_does(run, folder, files, tmp_path):
    edits = ["--remove", 1, "--move", "2:-20,8,90,3", "--insert", "cyclist:12,0.5,0,2", "--format", "json"]
    code, out, err = run("edit", "street.npz", *edits)
    assert code == 0 and "4 agents before, 4 now" in err and out.strip() == "street-edited.json"
    edited = load_json(tmp_path / "street-edited.json")
    np.testing.assert_allclose(edited.agents[:, :2], [[0, 0], [-20, 8], [20, 4], [12, 0.5]], atol=1e-5)
    np.testing.assert_allclose(edited.agents[[1, 3], 3], [3, 2], atol=1e-5)
    again = ["--remove", 1, "--regenerate-agents", "3", "--format", "json", *options(folder)]
    assert run("edit", "street.npz", *again)[0] == 0
    edited = load_json(tmp_path / "street-edited.json")
    np.testing.assert_allclose(edited.agents[:2], STREET.agents[[0, 2]], atol=1e-5)
    assert edited.num_agents == 3


def test_edit_empties_a_region(run, files, tmp_path):
    command = ["edit", "street.npz", "--regenerate-region", "5,-9,32,9", "--region-agents", 0, "--format", "json"]
    assert run(*command)[0] == 0
    np.testing.assert_allclose(load_json(tmp_path / "street-edited.json").agents, STREET.agents[[0, 2]], atol=1e-5)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["place", "map.json", "--at", "20,-2", "--agent", "car"], 2, "give either --at or --agent"),
        (["place", "map.json", "--map-out", "a.json"], 2, "--map-out is for one scene"),
        (["place", "map.json", "--at", "1,2", "--map-out", "a.png"], 2, "maps are .npz or .json files"),
        (["place", "map.json", "--ego-speed", "3"], 2, "--step and --ego-speed are for --at and --agent"),
        (["place", "map.json", "--at", "900,900"], 1, "at: no lane is within 150 m"),
        (["place", "map.json", "--agent", "bus"], 1, "the map has no such agent"),
        (["place", "log.npz", "--agent", "ego", "--step", "77"], 1, "log.npz: step is 77"),
        (["place", "street.npz", "--agents", "2"], 1, "num_agents must be a whole number in 4"),
        (["edit", "street.npz"], 2, "there is nothing to edit"),
        (["edit", "street.npz", "two cars", "--remove", "1"], 2, "PROMPT is for what is drawn anew"),
        (["edit", "street.npz", "--region-lanes", "--remove", "1"], 2, "are for --regenerate-region"),
        (["edit", "two.npz", "--remove", "1"], 2, "say which with --scene"),
        (["edit", "two.npz", "--remove", "1", "--scene", "2"], 2, "there is no scene 2"),
        (["edit", "street.npz", "--remove", "x"], 2, "'x' are no indices"),
        (["edit", "street.npz", "--remove", "0"], 1, "agent 0 is the ego"),
        (["edit", "street.npz", "--move", "9,9"], 2, "'9,9' is not of the form N:X,Y"),
        (["edit", "street.npz", "--move", "car:9,9"], 2, "'car' is no index"),
        (["edit", "street.npz", "--remove", "1", "--move", "1:9,9"], 2, "agent 1 is not there, or was removed"),
        (["edit", "street.npz", "--insert", "vehicle:1,0.5"], 1, "is taken: the box would overlap agent 0"),
        (["edit", "street.npz", "--insert", "tram:9,9"], 1, "agent_type must be one of"),
    ],
)
def test_commands_say_what_is_wrong_in_one_line(words, code, message, run, folder, files):
    actual, _, err = run(*words, *(["--model", folder] if words[0] == "place" else []))
    assert (actual, message in err) == (code, True), err
    assert code == 2 or len(err.splitlines()) <= 2  # a line may say which vehicle is the ego
