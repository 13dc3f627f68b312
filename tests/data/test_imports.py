"""Files of any format by content; public files where they are at hand."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest

from scjax.data.imports import find_format, import_log, import_map, read_any
from scjax.data.map_crop import crop_map
from scjax.data.readers import FORMATS, LogReader, open_folder
from scjax.scene import Log, Map, Scene, map_to_log, save_log, save_map, validate_map
from scjax.scene.io import save_json, save_npz
from tests.factories.examples import example_batch, example_scene
from tests.factories.logs import example_log
from tests.factories.map_files import write_map_files
from tests.factories.maps import two_tile_map
from tests.factories.scene_files import write_scene_file

NAMES = [entry.name for entry in FORMATS]


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, Path]:
    return write_map_files(tmp_path_factory.mktemp("maps"))


@pytest.mark.parametrize("name", NAMES)
def test_import_map_finds_the_format_by_content(name, files, tmp_path):
    renamed = tmp_path / "what.ever"
    renamed.write_bytes(files[name].read_bytes())
    assert find_format(renamed) == name
    map = validate_map(import_map(renamed))
    assert map.num_lanes >= 1 and isinstance(read_any(renamed), Log)
    packed = tmp_path / "packed.gz"
    packed.write_bytes(gzip.compress(files[name].read_bytes()))
    assert import_map(packed).num_lanes == map.num_lanes


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_is_cut_from_every_format(name, files):
    map = import_map(files[name])
    lane = next(lane for lane in map.lanes if lane.lane_type not in ("not_for_cars", "bike_lane"))
    assert crop_map(map, *lane.points.mean(0)[:2]).num_lanes >= 1


@pytest.mark.parametrize("name", NAMES)
def test_folders_of_every_format_are_opened(name, files, tmp_path):
    target = tmp_path / files[name].name
    target.write_bytes(files[name].read_bytes())
    for source in (tmp_path, target):
        reader = open_folder(source)
        assert isinstance(reader, LogReader) and reader.names() == [target.name]
        info, log = reader.scan(target.name), reader.read(target.name)
        assert not info.reason and info.sha256 == log.metadata.source_sha256
        assert (info.domain, info.cluster) == (log.metadata.domain, log.metadata.location_cluster)
    target.write_bytes(target.read_bytes()[:40])
    with pytest.raises(ValueError, match=target.name):
        open_folder(tmp_path).read(target.name)


@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_are_read_or_refused_in_one_line(name, files, tmp_path):
    data, rng = files[name].read_bytes(), np.random.default_rng(7)
    path = tmp_path / "damaged.bin"
    for case in range(40):
        damaged = bytearray(data[: rng.integers(1, len(data))] if case % 4 == 0 else data)
        for place in rng.integers(0, len(damaged), 1 + case % 3):
            damaged[place] = rng.integers(0, 256)
        path.write_bytes(damaged)
        try:
            validate_map(import_map(path))
        except ValueError as error:
            assert str(error).startswith(str(path)) and "\n" not in str(error)


def test_own_files_become_maps_and_logs(tmp_path):
    save_map(two_tile_map(), tmp_path / "map.json")
    save_map(two_tile_map(), tmp_path / "map.npz")
    save_log(example_log(), tmp_path / "log.npz")
    save_json(example_scene(), tmp_path / "scene.json")
    save_npz(example_batch(), tmp_path / "scenes.npz")
    recording = write_scene_file(tmp_path / "recordings")
    kinds = {find_format(path) for path in tmp_path.glob("*.*")} | {find_format(recording)}
    assert kinds == {"map", "log", "scene", "recording"}
    assert len(import_map(tmp_path / "map.json").tiles) == len(import_map(tmp_path / "map.npz").tiles) == 2
    assert import_map(tmp_path / "log.npz", step=2).num_agents == 2 and import_log(tmp_path / "map.npz").num_steps == 1
    assert len(import_map(tmp_path / "scene.json").tiles) == 1 and isinstance(read_any(tmp_path / "scenes.npz"), Scene)
    assert isinstance(read_any(tmp_path / "map.npz"), Map) and import_log(recording).num_objects
    with pytest.raises(ValueError, match="several scenes"):
        import_map(tmp_path / "scenes.npz")
    with pytest.raises(ValueError, match="scenes, which have no time"):
        import_log(tmp_path / "scene.json")
    with pytest.raises(ValueError, match="step is 99"):
        import_map(tmp_path / "log.npz", step=99)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "of no known format"),
        (b"<net version='1.16'/>", r"it looks like SUMO"),
        (b"<?xml version='1.0'?><OpenSCENARIO/>", "it looks like OpenSCENARIO"),
        (b"PAR1", "it looks like Parquet"),
        (b"{}", "of no known format"),
        (b"\x1f\x8b\x08cut", "not a complete gzip file"),
        (b"PK\x03\x04cut", "no readable .npz file"),
    ],
)
def test_unknown_files_are_refused_in_one_line(content, message, tmp_path):
    path = tmp_path / "file.dat"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as error:
        import_map(path)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


def test_files_that_are_not_there_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"gone\.osm: there is no such file"):
        import_map(tmp_path / "gone.osm")
    with pytest.raises(ValueError, match="is a folder"):
        import_map(tmp_path)


def test_a_map_with_traffic_becomes_a_log_of_one_step(files):
    log = map_to_log(import_map(files["CommonRoad"], step=1))
    assert log.num_objects == 1 and log.num_steps == 1
    np.testing.assert_allclose(log.positions[0, 0, :2], [2, 0])


def test_public_files_are_read():
    """Files of others, which never enter the repository: SCJAX_MAPS_DIR is a folder of such files."""
    folder = Path(os.environ.get("SCJAX_MAPS_DIR", "nowhere"))
    paths = sorted(path for entry in FORMATS for path in folder.rglob(entry.pattern))[:40]
    if not paths:
        pytest.skip("SCJAX_MAPS_DIR holds no maps: fetch some to run this test (docs/results/imports.md)")
    for path in paths:
        try:
            assert validate_map(import_map(path)).num_lanes
        except ValueError as error:
            assert str(error).startswith(str(path)) and "\n" not in str(error)
