"""scjax plot: pictures of every format, and one line where a file is at fault."""

from __future__ import annotations

import shutil

import pytest

from scjax.data.readers import FORMATS
from scjax.scene import save_log, save_map
from tests.factories.logs import example_log
from tests.factories.map_files import write_map_files
from tests.factories.maps import two_tile_map


@pytest.fixture(scope="module")
def map_files(tmp_path_factory):
    return write_map_files(tmp_path_factory.mktemp("maps"))


@pytest.mark.parametrize("name", [entry.name for entry in FORMATS])
def test_plot_draws_every_format(name, run, map_files, tmp_path):
    shutil.copy(map_files[name], tmp_path / "input.bin")
    code, out, _ = run("plot", "input.bin", "--view", "map")
    assert code == 0 and out.strip() == "input.png" and (tmp_path / "input.png").stat().st_size > 1000


def test_plot_shows_the_map_where_no_vehicle_is(run, tmp_path):
    save_map(two_tile_map(), tmp_path / "map.json")
    save_log(example_log(), tmp_path / "log.npz")
    assert run("plot", "map.json", "--out", "map.svg")[0] == 0
    assert "tile 1" in (tmp_path / "map.svg").read_text()
    code, _, err = run("plot", "log.npz")
    assert code == 0 and "the scene around object 0 at step 0" in err


def test_plot_cuts_a_scene_at_a_place(run, tmp_path):
    save_map(two_tile_map(), tmp_path / "map.npz")
    assert run("plot", "map.npz", "--at", "32,-2,90", "--speeds")[0] == 0
    assert (tmp_path / "map.png").stat().st_size > 1000


@pytest.mark.parametrize("name", ["clip.gif", "clip.mp4"])
def test_plot_animates_a_log(name, run, tmp_path):
    save_log(example_log(), tmp_path / "log.npz")
    code, out, err = run("plot", "log.npz", "--out", name, "--follow", "van", "--heading-up", "--radius", "20")
    assert (code, out.strip()) == (0, name), err
    assert (tmp_path / name).read_bytes()[4 * name.endswith("mp4") :].startswith((b"GIF89a", b"ftyp"))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["map.json", "--at", "here"], 2, "'here' is no place"),
        (["map.json", "--out", "map.pdf"], 2, "pictures are .png or .svg"),
        (["log.npz", "--out", "clip.mp4", "--step", "1"], 2, "are for pictures, not animations"),
        (["log.npz", "--heading-up"], 2, "give --out clip.mp4"),
        (["map.json", "--out", "clip.gif"], 1, "map.json holds a moment without time"),
        (["log.npz", "--out", "clip.gif", "--follow", "bus"], 1, "it has ego, van, pedestrian"),
        (["log.npz", "--step", "1"], 2, "--step is for --view map and --at"),
        (["log.npz", "--view", "map", "--step", "77"], 1, "log.npz: step is 77"),
        (["map.json", "--at", "900,900"], 1, "no lane is within 150 m"),
        (["cut.osm"], 1, "cut.osm: line 1"),
        (["unknown.osm"], 1, "unknown.osm: of no known format"),
    ],
)
def test_plot_says_what_is_wrong_in_one_line(arguments, code, message, run, tmp_path):
    save_map(two_tile_map(), tmp_path / "map.json")
    save_log(example_log(), tmp_path / "log.npz")
    (tmp_path / "cut.osm").write_text("<osm><node")
    (tmp_path / "unknown.osm").write_text("hello")
    actual, _, err = run("plot", *arguments)
    assert (actual, message in err) == (code, True), err
    assert code == 2 or len(err.splitlines()) == 1


def test_caption_describes_the_scene_of_a_map(run, map_files):
    code, out, err = run("caption", map_files["OpenDRIVE"])
    assert code == 0 and out.strip() and "a standing ego" in err
