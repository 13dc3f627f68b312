"""Synthetic worlds: determined by their numbers, sound networks, no overlaps, safe signals."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.scene import AgentType, Signal
from scjax.synthetic import actors
from scjax.synthetic.domains import DOMAINS, draw_domain
from scjax.synthetic.events.base import STAGED_IDS, StagedEvent
from scjax.synthetic.setting import VERSION
from scjax.synthetic.world import MAX_SCENES, World, make_world
from tests.factories.synthetic_scenes import NUM_WORLDS, SEED, example_worlds, scenes_of


@pytest.fixture(scope="module")
def worlds() -> tuple[World, ...]:
    return example_worlds()


def test_make_world_depends_on_its_numbers_only(worlds):
    again = make_world(SEED, 3)
    assert again.name == worlds[3].name and again.egos == worlds[3].egos
    for one, two in zip(again.moments, worlds[3].moments, strict=True):
        np.testing.assert_array_equal(one.positions, two.positions)


def test_make_world_differs_between_numbers(worlds):
    assert len({world.moments[0].positions.tobytes() for world in worlds}) == NUM_WORLDS


def test_make_world_rejects_negative_numbers():
    with pytest.raises(ValueError, match="counted from 0"):
        make_world(-1, 0)


def test_worlds_cover_all_domains(worlds):
    names = [draw_domain(np.random.default_rng([VERSION, SEED, k])).name for k in range(300)]
    assert set(names) == {domain.name for domain in DOMAINS}
    assert [world.domain for world in worlds] == names[:NUM_WORLDS]
    assert {world.mirrored for world in worlds} == {False, True}


def test_linked_lanes_share_their_end_points(worlds):
    for world in worlds:
        for lane in world.net.lanes:
            step = np.hypot(*np.diff(lane.points, axis=0).T)
            assert (step > 1e-3).all()
            for successor in lane.successors:
                assert np.hypot(*(lane.points[-1] - world.net.lanes[successor].points[0])) < 1e-6


def test_neighboring_lanes_are_a_lane_width_apart(worlds):
    for world in worlds:
        for k, lane in enumerate(world.net.lanes):
            if lane.right is None:
                continue
            neighbor = world.net.lanes[lane.right]
            assert neighbor.left == k
            middle = lane.points[len(lane.points) // 2]
            assert np.hypot(*(neighbor.points - middle).T).min() < 1.2 * lane.width


def test_agents_never_overlap(worlds):
    for world in worlds:
        for moment in world.moments:
            assert not len(actors.overlapping_actors(moment, 0.0))


def test_worlds_have_at_most_sixteen_scenes(worlds):
    assert MAX_SCENES <= 16 and all(len(world.egos) <= MAX_SCENES for world in worlds)
    assert np.mean([len(world.egos) for world in worlds]) > 5


def test_crossing_connectors_have_no_green_together(worlds):
    num_green = 0
    for world in worlds:
        arms = np.array([lane.arm for lane in world.net.lanes])
        for signals in world.signals:
            green = np.flatnonzero(signals == Signal.GO)
            num_green += len(green) > 0
            for a, b in np.argwhere(world.lanes.conflicts[np.ix_(green, green)]):
                assert arms[green[a]] == arms[green[b]]
    assert num_green > 5


def test_scenes_without_the_event_are_far_from_every_wrong_way_driver():
    """The driver is often slow at a moment, which then does not show the event; it is no ordinary traffic either."""
    num_slow = 0
    for k in range(12):
        world = make_world(29, k, events=("wrong-way",))
        for ego in world.egos:
            moment = world.moments[ego.moment]
            drivers = np.flatnonzero((moment.ids >= STAGED_IDS) & (moment.types == AgentType.VEHICLE))
            if ego.event is None and len(drivers):
                distance = np.hypot(*(moment.positions[drivers[0]] - moment.positions[ego.agent]))
                assert distance > StagedEvent.clearance
        num_slow += sum((moment.speeds[moment.ids >= STAGED_IDS] < 3.0).any() for moment in world.moments)
    assert num_slow > 0


def test_lanes_of_scenes_show_sharp_bends(worlds):
    """The 20 points of a lane follow its turns."""
    for world in worlds:
        for _, scene in scenes_of(world):
            steps = np.diff(scene.lanes[..., :2], axis=1)
            turns = np.angle(np.exp(1j * np.diff(np.arctan2(steps[..., 1], steps[..., 0]), axis=1)))
            is_long = np.hypot(*np.moveaxis(steps, -1, 0)).min(1) > 0.05
            assert np.rad2deg(np.abs(turns[is_long]).max()) < 25.0
