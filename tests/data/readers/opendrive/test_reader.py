import numpy as np
import pytest

from scjax.cli.data import main as data_main
from scjax.data.lane_graph import build_graph
from scjax.data.readers import LogReader, open_folder
from scjax.data.readers.opendrive import read_opendrive, read_road_map
from scjax.data.readers.xml_elements import MAX_DEPTH, parse_elements
from scjax.data.records import open_records, read_record, sample_scene
from scjax.scene import LaneNeighbor, Signal, validate
from tests.factories import opendrive_files as files
from tests.factories.opendrive_files import lane, road, section, write_map


def test_read_opendrive_gives_a_map_without_objects(tmp_path):
    light = '<signal id="5" s="90" orientation="+" type="1000001"/><signal id="6" s="3" type="206"/>'
    content = list(files.fork())
    content[0] = content[0].replace("<signals></signals>", f"<signals>{light}</signals>")
    log = read_opendrive(write_map(tmp_path, *content))
    assert log.num_steps == 1 and log.num_objects == 0 and log.has_topology
    assert log.signal_lane_ids == ("4.0.-1", "5.0.1") and (log.signal_states == Signal.UNKNOWN).all()
    np.testing.assert_allclose(log.signal_positions, [[100, 0, 0]] * 2, atol=1e-6)
    assert log.metadata.notes == {"stop signs, not read": 1} and log.metadata.location_cluster == "map"
    assert build_graph(log).num_lanes == 3  # road 1, and each way with the road behind it


def test_lanes_have_the_words_of_the_vocabulary(tmp_path):
    words = ("driving", "biking", "sidewalk", "parking", "bus", "onRamp", "none", "hovercraft")
    log = read_opendrive(write_map(tmp_path, road("1", section(*(lane(-1 - k, word) for k, word in enumerate(words))))))
    assert [lane.lane_type for lane in log.lanes] == [
        "surface_street",
        "bike_lane",
        "not_for_cars",
        "not_for_cars",
        "bus_lane",
        "freeway",
        None,
    ]
    assert log.metadata.unknown_words == {"lane type: hovercraft": 1}


def test_lanes_of_a_motorway_are_freeway(tmp_path):
    text = road("1").replace("<link>", '<type s="0" type="motorway"/><link>', 1)
    assert {lane.lane_type for lane in read_opendrive(write_map(tmp_path, text)).lanes} == {"freeway"}


def test_lane_for_turns_of_both_directions_is_no_way_through(tmp_path):
    log = read_opendrive(write_map(tmp_path, road("1", section(lane(1, "bidirectional"), lane(-1)))))
    assert {lane.id: lane.lane_type for lane in log.lanes} == {"1.0.1": "undefined", "1.0.-1": "surface_street"}


@pytest.mark.parametrize(("rule", "left"), [("RHT", "1.0.-1"), ("LHT", "1.0.-2")])
def test_neighbors_are_left_and_right_of_the_driver(tmp_path, rule, left):
    text = road("1", section(lane(1), lane(-1), lane(-2), lane(-3, "shoulder")), more=f'rule="{rule}"')
    lanes = {lane.id: lane for lane in read_opendrive(write_map(tmp_path, text)).lanes}
    right = {"1.0.-1": "1.0.-2", "1.0.-2": "1.0.-1"}[left]
    last = len(lanes[left].points) - 1
    assert lanes[left].right_neighbors == (LaneNeighbor(right, 0, last, 0, last),) and not lanes[left].left_neighbors
    assert lanes[right].left_neighbors == (LaneNeighbor(left, 0, last, 0, last),)
    assert not lanes["1.0.1"].left_neighbors + lanes["1.0.1"].right_neighbors  # oncoming
    assert len(build_graph(read_opendrive(tmp_path / "map.xodr")).neighbors) == 1


def test_read_road_map_keeps_widths_and_words(tmp_path):
    lines = read_road_map(write_map(tmp_path, road("1", section(lane(-1), lane(-2, "sidewalk", 2.0))))).lines
    assert [(line.lane.type, line.widths[0]) for line in lines.values()] == [("driving", 3.5), ("sidewalk", 2.0)]


def test_folder_and_file_are_opened_by_their_pattern(tmp_path):
    write_map(tmp_path, road("1"))
    (tmp_path / "deep").mkdir()
    write_map(tmp_path / "deep", road("1"), name="other.xodr")
    reader = open_folder(tmp_path)
    assert isinstance(reader, LogReader) and reader.names() == ["deep/other.xodr", "map.xodr"]
    info = reader.scan("deep/other.xodr")
    assert (info.domain, info.cluster, info.reason) == ("opendrive", "deep/other", "")
    one = open_folder(tmp_path / "map.xodr")
    assert one.names() == ["map.xodr"] and str(one) == str(tmp_path / "map.xodr")
    assert one.read("map.xodr").metadata.source_sha256 == one.scan("map.xodr").sha256


def test_file_of_another_kind_is_refused(tmp_path):
    (tmp_path / "map.txt").write_text("<osm/>")
    with pytest.raises(ValueError, match=r"map\.txt: neither .*xodr"):
        open_folder(tmp_path / "map.txt")


def test_build_makes_records_of_a_file(tmp_path, capsys):
    path = write_map(tmp_path, *files.fork())
    command = ["build", str(path), str(tmp_path / "out"), "--workers", "0", "--split-percent", "0"]
    assert data_main(command) == 1 and "--lane-poses" in capsys.readouterr().err
    assert data_main([*command, "--lane-poses", "4"]) == 0
    shards = open_records(tmp_path / "out", "train")
    scenes = [validate(sample_scene(read_record(shards, k))) for k in range(len(shards))]
    assert len(scenes) == 4 and all(len(scene.lanes) for scene in scenes)


DAMAGE = {
    "empty": (b"", "line 1: no sound XML"),
    "no xml": (b"road network", "line 1: no sound XML"),
    "cut": (files.document(road("1")).encode()[:-200], "line 2: no sound XML"),
    "other root": (b"<osm/>", "the root is <osm>"),
    "no road": (files.document().encode(), "has no <road>"),
    "two roads": (files.document(road("1"), road("1")).encode(), "another road has the same id"),
    "no id": (files.document(road("1").replace(' id="1"', "")).encode(), "<road>: has no id"),
    "entity": (b'<!DOCTYPE x [<!ENTITY a "b">]><OpenDRIVE>&a;</OpenDRIVE>', "defines the entity 'a'"),
    "deep": (b"<a>" * (MAX_DEPTH + 1), "nested elements"),
    "encoding": (b'<?xml version="1.0" encoding="klingon"?><OpenDRIVE/>', "no sound XML"),
    "sidewalks": (files.document(road("1", section(lane(-1, "sidewalk")))).encode(), "no lane that is driven on"),
    "number": (files.document(road("1")).replace('hdg="0.0"', 'hdg="north"').encode(), "<geometry>: hdg is 'north'"),
    "nan": (files.document(road("1")).replace('a="3.5"', 'a="nan"').encode(), "<width>: a is nan"),
}


@pytest.mark.parametrize(("data", "word"), DAMAGE.values(), ids=DAMAGE)
def test_damaged_file_is_refused_in_one_line(tmp_path, data, word):
    path = tmp_path / "map.xodr"
    path.write_bytes(data)
    with pytest.raises(ValueError) as caught:
        read_opendrive(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and word in message and "\n" not in message
    assert message.rpartition(": ")[2].split()[0] in ("copy", "correct", "give", "remove", "leave")


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"gone\.xodr: No such file"):
        read_opendrive(tmp_path / "gone.xodr")


def test_elements_know_their_lines_and_leave_out_what_nobody_reads():
    root = parse_elements(b"<a>\n<userData><b/></userData>\n<x:c v='1'><d/></x:c>\n</a>")
    (child,) = root.children
    assert (child.tag, child.line, child.attributes, len(child.children)) == ("c", 3, {"v": "1"}, 1)
