import numpy as np
import pytest

from scjax.cli.data import main as data_main
from scjax.data.build import build_records
from scjax.data.build_options import BuildOptions
from scjax.data.records import open_records, read_record, sample_scene
from scjax.scene import validate
from scjax.towns import source, sumo
from scjax.towns.source import Towns, make_towns
from scjax.towns.sumo import find_sumo
from tests.factories import opendrive_files as files
from tests.factories.town_traffic import write_fork_town


def _towns(tmp_path) -> Towns:
    """Two towns of the same map, one held back."""
    return write_fork_town(tmp_path, {"A": "train", "B": "val"})


def test_logs_are_named_by_town_simulation_and_number(tmp_path):
    towns = _towns(tmp_path)
    assert towns.names() == ["A/0/0000", "A/0/0001", "B/0/0000", "B/0/0001"]
    infos = [towns.scan(name) for name in towns.names()]
    assert len({info.sha256 for info in infos}) == 4
    assert {(info.domain, info.cluster, info.split) for info in infos} == {
        ("carla", "A", "train"),
        ("carla", "B", "val"),
    }


def test_lanes_end_where_their_signal_does(tmp_path):
    towns = _towns(tmp_path)
    posed = towns.load(towns.scan("A/0/0001"), BuildOptions(), dense=False)
    assert posed.graph.num_lanes == 5  # roads 1 to 3, way 4 with its signal, way 5 that turns
    assert (posed.graph.signals[:, 20] > 0).sum() == 1


def test_towns_are_held_back_whole(tmp_path):
    manifest = build_records(_towns(tmp_path), tmp_path / "out", BuildOptions(split_percent=0.0))
    assert manifest["domains"] == ["carla"]
    assert [manifest["splits"][split]["clusters"] for split in ("train", "val")] == [["carla/A"], ["carla/B"]]
    shards = open_records(tmp_path / "out", "val")
    scene = validate(sample_scene(read_record(shards, 0)))
    assert len(scene.agents) == 2 and scene.agents[0, 3] == pytest.approx(5.0, abs=0.02)


def test_scenes_stay_away_from_lanes_on_each_other(tmp_path, monkeypatch):
    towns = _towns(tmp_path)
    info = towns.scan("A/0/0001")
    free = towns.load(info, BuildOptions(), dense=True).poses
    place = free[0].x, free[0].y
    monkeypatch.setattr(source, "overlap_places", lambda lines: np.array([place]))
    posed = towns.load(info, BuildOptions(), dense=True)
    assert all(np.hypot(pose.x - place[0], pose.y - place[1]) > 75.0 for pose in posed.poses)
    assert 0 <= posed.num_standard <= len(posed.poses) < len(free)


@pytest.fixture
def no_sumo(monkeypatch):
    monkeypatch.delenv(sumo.VARIABLE, raising=False)
    monkeypatch.setattr(sumo, "installed_module", lambda name: None)
    monkeypatch.setenv("PATH", "")


def test_missing_sumo_is_one_line(no_sumo, tmp_path, capsys):
    files.write_map(tmp_path, *files.fork())
    assert data_main(["towns", str(tmp_path / "out"), "--maps", str(tmp_path), "--workers", "0"]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "scjax[traffic]" in error and "SUMO_HOME" in error


@pytest.mark.parametrize(
    ("changes", "word"),
    [({"runs": 0}, "runs"), ({"seconds": 5.0}, "seconds"), ({"names": ("Town99",)}, "Town99"), ({"seed": -1}, "seed")],
)
def test_arguments_out_of_range_are_refused(tmp_path, changes, word):
    files.write_map(tmp_path, *files.fork())
    with pytest.raises(ValueError, match=word):
        make_towns(tmp_path, **changes)


def test_folder_without_maps_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"no \*\.xodr"):
        make_towns(tmp_path)


def test_simulated_map_gives_sound_records(tmp_path, monkeypatch):
    """The whole way, where SUMO is installed."""
    try:
        find_sumo()
    except ValueError:
        pytest.skip("SUMO is not here: set SUMO_HOME")
    monkeypatch.setenv("SCJAX_CACHE", str(tmp_path / "cache"))
    (tmp_path / "maps").mkdir()
    files.write_map(tmp_path / "maps", *files.fork(), name="fork.xodr")
    towns = make_towns(tmp_path / "maps", runs=1, seconds=30.0)
    assert make_towns(tmp_path / "maps", runs=1, seconds=30.0) == towns  # from the cache
    for name in towns.names():
        log = towns.load(towns.scan(name), BuildOptions(), dense=False).log
        assert log.valid[log.ego_index].all() and np.abs(log.positions[log.ego_index, :, 2]).max() < 3
