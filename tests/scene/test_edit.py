"""Edits of scenes by hand: what is named changes, everything else stays bit for bit, faults are named."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.scene import AgentType, Scene, unpadded, validate
from scjax.scene.agent_sizes import CLASS_SIZES, CLASS_SPEEDS
from scjax.scene.edit import insert_agent, move_agent, remove_agents
from scjax.scene.regions import inside_polygon, region_polygon
from tests.factories.examples import example_batch, example_scene
from tests.factories.traffic import agent, lane, scene

AGENT_FIELDS = ("agents", "agent_types", "agent_mask", "agent_known")
STREET = scene(
    [agent(0, 0), agent(12, 0), agent(-12, 0, 30.0)], [lane((-30, 0), (30, 0)), lane((30, 4), (-30, 4), z=2.0)]
)


def assert_same_lanes(one: Scene, other: Scene):
    for name, value in one.to_dict().items():
        if name not in AGENT_FIELDS:
            np.testing.assert_array_equal(getattr(other, name), value, err_msg=name)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_not_named_stays_bit_for_bit(seed):
    padded = example_scene(seed, agents=5)
    before = unpadded(padded)
    removed = remove_agents(padded, [3, 1, 3])
    inserted = insert_agent(removed, AgentType.STATIC, 31.0, 31.0)
    moved = move_agent(inserted, 3, -31.0, 31.0)
    for after in (removed, inserted, moved):
        assert_same_lanes(before, validate(after))
        for name in AGENT_FIELDS:
            np.testing.assert_array_equal(getattr(after, name)[:3], getattr(before, name)[[0, 2, 4]])
    assert [int(one.num_agents) for one in (removed, inserted, moved)] == [3, 4, 4]


@pytest.mark.parametrize("kind", AgentType)
def test_inserted_agent_has_the_usual_values_of_its_class(kind):
    after = validate(insert_agent(STREET, kind.name.lower(), 5.0, 8.0, np.pi / 2))
    length, width, height = CLASS_SIZES[kind]
    expected = [5, 8, 2 + height / 2, CLASS_SPEEDS[kind], 0, 1, length, width, height]  # the nearest lane is 2 m up
    np.testing.assert_allclose(after.agents[3], expected, atol=1e-6)
    assert after.agent_types[3] == kind and after.agent_known[3].all()


def test_inserted_agent_takes_values_that_are_given():
    after = insert_agent(STREET, 0, 5.0, -8.0, speed=3.0, size=(8.0, 2.5, 3.0))
    np.testing.assert_allclose(after.agents[3], [5, -8, 1.5, 3, 1, 0, 8, 2.5, 3])


def test_moved_agent_keeps_what_is_not_given():
    after = move_agent(STREET, 1, y=8.0)
    np.testing.assert_allclose(after.agents[1], STREET.agents[1] + np.array([0, 8, 2, 0, 0, 0, 0, 0, 0]), atol=1e-6)
    turned = move_agent(STREET, 2, heading=0.0, speed=9.0)
    np.testing.assert_allclose(turned.agents[2, 3:6], [9, 1, 0])
    np.testing.assert_array_equal(turned.agents[2, :3], STREET.agents[2, :3])


def test_of_the_ego_only_the_speed_changes():
    after = move_agent(STREET, 0, speed=4.0)
    assert after.agents[0, 3] == 4 and np.array_equal(np.delete(after.agents, 3, 1), np.delete(STREET.agents, 3, 1))


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda s: remove_agents(s, 0), "agent 0 is the ego"),
        (lambda s: remove_agents(s, 3), r"agents: each index must be a whole number in 0\.\.2, not 3"),
        (lambda s: move_agent(s, 0, 1.0, 1.0), "agent 0 is the ego, the origin of the frame: it cannot move"),
        (lambda s: move_agent(s, 7, 1.0), r"agent must be a whole number in 0\.\.2"),
        (lambda s: move_agent(s, 2, 12.0, 0.5), "x 12, y 0.5 is taken: the box would overlap agent 1"),
        (lambda s: move_agent(s, 1, 99.0), r"x \(the window of the scene\) must be a finite number in -32"),
        (lambda s: move_agent(s, 1, speed=np.nan), "speed must be a finite number"),
        (lambda s: insert_agent(s, "vehicle", 1.0, 0.5), "is taken: the box would overlap agent 0"),
        (lambda s: insert_agent(s, "tram", 1.0, 9.0), "agent_type must be one of vehicle, pedestrian"),
        (lambda s: insert_agent(s, "vehicle", 1.0, 9.0, size=(1.0, 2.0)), "size must be length, width and height"),
        (lambda s: insert_agent(s, "vehicle", 1.0, 9.0, size=(1.0, 2.0, 0.0)), "size: each number"),
        (lambda s: insert_agent(remove_all(s), "vehicle", 1.0, 9.0), "scene has no agents"),
        (lambda s: remove_agents(example_batch(2), 1), "scene must be one scene, not a batch"),
    ],
)
def test_faults_are_named(edit, message):
    with pytest.raises(ValueError, match=message):
        edit(STREET)


def remove_all(one: Scene) -> Scene:
    return one.replace(**{name: getattr(one, name)[:0] for name in AGENT_FIELDS})


def test_points_in_boxes_and_polygons():
    points = np.array([[1, 1], [3, 1], [1, 3], [-1, 1], [1.9, 0.1]])
    assert inside_polygon(points, region_polygon((2, 0, 0, 2))).tolist() == [True, False, False, False, True]
    corner = region_polygon([(0, 0), (2, 0), (0, 2)])
    assert inside_polygon(points + np.array([-0.5, -0.5]), corner).tolist() == [True, False, False, False, False]
    assert inside_polygon(points.reshape(5, 1, 2), corner).shape == (5, 1)


@pytest.mark.parametrize("region", [(1, 2, 3), [(0, 0), (1, 1)], "here", (0, 0, 0, 4), (0, 0, np.nan, 4), None])
def test_regions_that_enclose_nothing_are_refused(region):
    with pytest.raises(ValueError, match="region"):
        region_polygon(region)
