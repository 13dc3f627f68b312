"""Scenes seen in a mirror with time running backwards."""

import dataclasses

import numpy as np

from scjax.data import records
from scjax.data.backwards import backwards
from scjax.data.build import build
from scjax.data.sources import BuildOptions
from scjax.scene import Layout, Link, validate
from tests.data import raw_scenes
from tests.data.test_records import make


def cut(context):
    return validate(records.sample_scene(records.Record(context, 0, "", "", 0, 0, True)))


def test_twice_is_as_it_was(tmp_path):
    record, _ = make(tmp_path)
    for field in dataclasses.fields(record.context):
        want, got = getattr(record.context, field.name), getattr(backwards(backwards(record.context)), field.name)
        np.testing.assert_allclose(got, want, atol=1e-5, err_msg=field.name)
        assert got.dtype == want.dtype


def test_lanes_run_the_other_way_and_sides_stay(tmp_path):
    record, _ = make(tmp_path, pose=1)
    one, other = cut(record.context), cut(backwards(record.context))
    mirrored = one.lanes[:, ::-1] * np.float32([-1, 1, 1])
    same = [int(np.abs(other.lanes - lane).max((1, 2)).argmin()) for lane in mirrored]
    assert sorted(same) == list(range(len(one.lanes)))
    np.testing.assert_allclose(other.lanes[same], mirrored, atol=2e-3)
    links = other.links[np.ix_(same, same)]
    assert {Link.LEFT, Link.SUCCESSOR} <= set(one.links.ravel().tolist())
    for link in (Link.LEFT, Link.RIGHT):
        np.testing.assert_array_equal(links == link, one.links == link)
    np.testing.assert_array_equal(links == Link.SUCCESSOR, one.links == Link.PREDECESSOR)
    np.testing.assert_array_equal(other.signals[same], one.signals)


def test_the_ego_still_drives_forward_and_others_are_mirrored(tmp_path):
    record, _ = make(tmp_path, pose=1)
    one, other = cut(record.context), cut(backwards(record.context))
    np.testing.assert_array_equal(other.agents[0], one.agents[0])
    np.testing.assert_array_equal(other.agents[:, 0], -one.agents[:, 0])
    np.testing.assert_array_equal(other.agents[:, [1, 3, 4]], one.agents[:, [1, 3, 4]])  # y, speed, along x as it was
    np.testing.assert_array_equal(other.agents[:, 5], -one.agents[:, 5])


def test_only_training_records_are_doubled(tmp_path):
    for number in range(6):
        raw_scenes.write(tmp_path / "in", raw_scenes.content(str(number), str(number)), f"{number}.json.gz")
    plain, both = (
        build(tmp_path / "in", tmp_path / str(twice), BuildOptions(split_percent=50.0, backwards=twice))
        for twice in (False, True)
    )
    count = {name: [made["splits"][name]["records"] for made in (plain, both)] for name in ("train", "val")}
    assert count["train"][1] == 2 * count["train"][0] > 0 and count["val"][1] == count["val"][0] > 0
    assert both["domains"] == ["womd", "womd backwards"]
    assert [row for row in both["counts"] if not row[0]] == plain["counts"]
    assert both["splits"]["val"]["clusters"] == plain["splits"]["val"]["clusters"]
    read = [records.decode(data) for data in records.source(tmp_path / "True", "train")]
    want = records.sample_scene(dataclasses.replace(read[0], context=backwards(read[0].context)), Layout.FORWARD)
    assert [record.domain for record in read[:4]] == [0, 1, 0, 1]
    np.testing.assert_array_equal(records.sample_scene(read[1], Layout.FORWARD).lanes, want.lanes)
