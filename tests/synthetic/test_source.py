"""Synthetic worlds as a source of records: share of ordinary scenes, choice of events."""

from __future__ import annotations

import collections

import pytest

from scjax.data.build_options import BuildOptions
from scjax.data.record_source import PosedLog
from scjax.language.analysis.rare_events import EVENTS
from scjax.synthetic.labels import SceneLabel
from scjax.synthetic.source import Worlds

SHARES = (0.0, 0.4, 1.0)


def load_all(source: Worlds) -> list[PosedLog]:
    return [source.load(source.scan(name), BuildOptions(), False) for name in source.names()]


@pytest.fixture(scope="module")
def logs_by_share() -> dict[float, list[PosedLog]]:
    """Logs of the same worlds with different shares of ordinary scenes."""
    return {share: load_all(Worlds(9, 8, share)) for share in SHARES}


@pytest.mark.parametrize("share", SHARES)
def test_worlds_label_every_pose(logs_by_share, share):
    logs = logs_by_share[share]
    num_labels = sum(len(log.labels) for log in logs)
    poses = {(k, pose.object_index, pose.step) for k, log in enumerate(logs) for pose in log.poses}
    assert num_labels == len(poses) == sum(log.num_standard for log in logs)


@pytest.mark.parametrize("share", SHARES)
def test_worlds_without_ordinary_scenes_are_all_rare(logs_by_share, share):
    labels = [SceneLabel(**label) for log in logs_by_share[share] for label in log.labels]
    num_rare = sum(label.rare for label in labels)
    assert num_rare > 0 and (num_rare == len(labels)) == (share == 0.0)


def test_worlds_with_larger_share_keep_all_scenes_of_smaller(logs_by_share):
    poses = {
        share: {(k, pose.object_index, pose.step) for k, log in enumerate(logs) for pose in log.poses}
        for share, logs in logs_by_share.items()
    }
    assert poses[0.0] < poses[0.4] < poses[1.0]


def test_worlds_keep_two_rare_scenes_per_event(logs_by_share):
    largest = {}
    for share, logs in logs_by_share.items():
        counts = [collections.Counter(label["event"] for label in log.labels) for log in logs]
        largest[share] = max(count[event] for count in counts for event in EVENTS)
    assert largest[0.0] == 2 < largest[1.0]


def test_worlds_reject_shares_above_one():
    with pytest.raises(ValueError, match="a share from 0 to 1"):
        Worlds(7, 12, 1.5)


@pytest.mark.parametrize("events", [("jaywalker",), ("jaywalker", "wrong-way")])
def test_worlds_show_chosen_events_only(events):
    labels = [label for log in load_all(Worlds(5, 12, events=events)) for label in log.labels]
    counts = collections.Counter(label["event"] for label in labels if label["event"])
    assert set(counts) == set(events) and counts.total() >= 5


@pytest.mark.parametrize("events", [("jaywalker",), ("jaywalker", "wrong-way")])
def test_worlds_hash_depends_on_events(events):
    """A build that resumes must not take records of other worlds for its own."""
    source, plain = Worlds(5, 12, events=events), Worlds(8, 12)
    assert source.scan(source.names()[0]).sha256 != plain.scan(plain.names()[0]).sha256


def test_worlds_reject_unknown_events():
    with pytest.raises(ValueError, match="unknown event 'accident': choose of wrong-way, jaywalker"):
        Worlds(8, 12, events=("accident",))
