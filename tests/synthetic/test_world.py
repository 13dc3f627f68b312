from __future__ import annotations

import collections

import numpy as np
import pytest

from scjax.data.build_options import BuildOptions
from scjax.data.lane_graph import build_graph, index_segments
from scjax.data.local_map import simplify_graph
from scjax.data.records import make_record, sample_scene
from scjax.data.tiles import pose_of
from scjax.language.facts import extract_facts
from scjax.scene import AgentType, Signal, validate
from scjax.synthetic import actors, domains, events
from scjax.synthetic.labels import Label, label
from scjax.synthetic.source import Worlds
from scjax.synthetic.world import CROPS, VERSION, World, make_world, object_of, raw_scene

MANY = 40


@pytest.fixture(scope="module")
def worlds() -> list[World]:
    return [make_world(7, k) for k in range(MANY)]


def scenes_of(world: World):
    """Every scene of a world with its ego."""
    log = raw_scene(world)
    graph = build_graph(log)
    index, lanes = index_segments(graph), simplify_graph(graph)
    for ego in world.egos:
        pose = pose_of(log, index, ego.moment, object_of(world, ego.moment, ego.agent))
        yield ego, sample_scene(make_record(log, lanes, index, pose, 0)[0], off_road=True)


def test_a_world_depends_on_its_numbers_alone(worlds):
    again = make_world(7, 3)
    assert again.name == worlds[3].name and again.egos == worlds[3].egos
    for one, two in zip(again.moments, worlds[3].moments, strict=True):
        np.testing.assert_array_equal(one.places, two.places)
    assert len({world.moments[0].places.tobytes() for world in worlds}) == MANY
    with pytest.raises(ValueError, match="counted from 0"):
        make_world(-1, 0)


def test_all_domains_occur(worlds):
    assert {world.domain for world in worlds} == {domain.name for domain in domains.DOMAINS}
    assert {world.mirrored for world in worlds} == {False, True}


def test_lanes_meet_where_they_are_joined(worlds):
    for world in worlds:
        for lane in world.net.lanes:
            step = np.hypot(*np.diff(lane.points, axis=0).T)
            assert (step > 1e-3).all()
            for after in lane.successors:
                assert np.hypot(*(lane.points[-1] - world.net.lanes[after].points[0])) < 1e-6


def test_neighbours_are_a_lane_width_apart(worlds):
    for world in worlds:
        for k, lane in enumerate(world.net.lanes):
            if lane.right is None:
                continue
            other = world.net.lanes[lane.right]
            assert other.left == k
            middle = lane.points[len(lane.points) // 2]
            assert np.hypot(*(other.points - middle).T).min() < 1.2 * lane.width


def test_nobody_overlaps(worlds):
    for world in worlds:
        for moment in world.moments:
            assert not len(actors.overlapping(moment, 0.0))


def test_at_most_sixteen_scenes_of_one_world(worlds):
    assert CROPS <= 16 and all(len(world.egos) <= CROPS for world in worlds)
    assert np.mean([len(world.egos) for world in worlds]) > 5


def test_paths_that_cross_have_no_green_together(worlds):
    lit = 0
    for world in worlds:
        for lights in world.lights:
            green = np.flatnonzero(lights == Signal.GO)
            lit += len(green) > 0
            for a, b in np.argwhere(world.tracks.conflict[np.ix_(green, green)]):
                turns = {world.net.lanes[green[a]].turn, world.net.lanes[green[b]].turn}
                # Left turns without a lane of their own give way; connectors may also meet in one exit.
                assert "left" in turns or set(world.tracks.successors[green[a]]) & set(
                    world.tracks.successors[green[b]]
                )
    assert lit > 5


def test_left_hand_worlds_are_mirrored(worlds):
    world = next(world for world in worlds if world.mirrored)
    log = raw_scene(world)
    np.testing.assert_allclose(log.lanes[0].points[:, :2], world.net.lanes[0].points * [1, -1])
    first = log.positions[np.arange(len(world.moments[0])), 0]
    np.testing.assert_allclose(first[:, 1], -world.moments[0].places[:, 1])
    for lane, made in zip(log.lanes, world.net.lanes, strict=True):
        assert [int(name) for name, *_ in lane.left_neighbors] == ([] if made.right is None else [made.right])


def test_scenes_are_valid_and_known_as_they_were_made(worlds):
    right, total, vehicles = collections.Counter(), collections.Counter(), []
    for world in worlds:
        for ego, scene in scenes_of(world):
            validate(scene)
            facts, told = extract_facts(scene), label(world, ego)
            vehicles.append((scene.agent_types == AgentType.VEHICLE).sum())
            for name, value, found in (
                ("layout", told.layout, facts.layout), ("signal", told.signal, facts.signals or "")
            ):  # fmt: skip
                if value is not None:
                    total[name] += 1
                    right[name] += value == found
    assert total["layout"] > 60 and total["signal"] > 60
    assert right["layout"] / total["layout"] >= 0.95 and right["signal"] / total["signal"] >= 0.95
    assert 4 < np.mean(vehicles) < 10


def test_rare_events_are_found(monkeypatch):
    monkeypatch.setattr(domains, "EVENTS", 1.0)
    found, total, invented, scenes = collections.Counter(), collections.Counter(), 0, 0
    for k in range(50):
        world = make_world(11, k)
        for ego, scene in scenes_of(world):
            facts = extract_facts(scene)
            scenes += 1
            invented += bool(set(facts.events) - {ego.event})
            if ego.event is not None:
                total[ego.event] += 1
                found[ego.event] += ego.event in facts.events
    assert sum(found.values()) / sum(total.values()) >= 0.9
    assert len(total) >= 5 and all(kind in events.EVENTS for kind in total)
    assert invented / scenes < 0.02


def test_roundabouts_that_are_labelled_are_read_as_such():
    found = collections.Counter()
    for k in range(400):
        rng = np.random.default_rng([VERSION, 7, k])
        if domains.draw(rng).network(rng)[0] == "roundabout":
            world = make_world(7, k)
            found.update(
                extract_facts(scene).layout
                for ego, scene in scenes_of(world)
                if label(world, ego).layout == "roundabout"
            )
        if found.total() >= 3:
            break
    assert found.total() >= 3 and set(found) == {"roundabout"}


def test_ordinary_scenes_can_be_left_out():
    options = BuildOptions()
    kept, most = {}, {}
    for share in (0.0, 0.4, 1.0):
        source = Worlds(7, 12, share)
        loaded = [source.load(source.scan(name), options, False) for name in source.names()]
        kept[share] = {(k, pose.object_index, pose.step) for k, one in enumerate(loaded) for pose in one.poses}
        labels = [found for one in loaded for found in one.labels]
        assert len(labels) == len(kept[share]) == sum(one.num_standard for one in loaded)
        rare = sum(Label(**found).rare for found in labels)
        assert rare > 0 and (rare == len(labels)) == (share == 0.0)
        told = [collections.Counter(found["event"] for found in one.labels) for one in loaded]
        most[share] = max(counts[event] for counts in told for event in events.EVENTS)
    assert kept[0.0] < kept[0.4] < kept[1.0]
    assert most[0.0] == 2 < most[1.0]
    with pytest.raises(ValueError, match="a share from 0 to 1"):
        Worlds(7, 12, 1.5)


def test_events_can_be_chosen():
    options = BuildOptions()
    plain = Worlds(8, 12)
    for chosen in (("jaywalker",), ("jaywalker", "wrong-way driver")):
        source = Worlds(8, 12, events=chosen)
        labels = [label for name in source.names() for label in source.load(source.scan(name), options, False).labels]
        told = collections.Counter(label["event"] for label in labels if label["event"])
        assert set(told) == set(chosen) and told.total() >= 5
        # Records of other worlds are not taken for these when a build goes on.
        assert source.scan(source.names()[0]).sha256 != plain.scan(plain.names()[0]).sha256
    with pytest.raises(ValueError, match="unknown event 'accident': choose of wrong-way driver, jaywalker"):
        Worlds(8, 12, events=("accident",))
