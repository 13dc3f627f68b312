"""Places on known lanes for agents whose kinds are of another scene."""

from __future__ import annotations

import numpy as np

from scjax.generate.lane_places import along_lanes, keep_to_lanes, settle_agents
from scjax.models import codec as presets
from scjax.models.denoiser.kinds import NO_KIND, agent_digits, agent_kinds, digits_of
from scjax.scene import AgentType
from scjax.scene.boxes import overlaps
from tests.factories.traffic import agent, lane, scene

CODEC = presets.scjax()
DIGITS = agent_digits(CODEC)
ROAD = scene([agent(0, 0)], [lane((-32, 0), (32, 0)), lane((32, 4), (-32, 4))])
PERSON = (0.9, 0.8, 1.7)


def _kinds(agents, lanes, types=None):
    """Kinds of the agents of another scene, the ego of ``ROAD`` first."""
    return np.asarray(agent_kinds(scene([agent(0, 0), *agents], lanes, types=types), CODEC))


def _settled(agents, lanes, known=ROAD, **options):
    placed = settle_agents(np.random.default_rng(0), _kinds(agents, lanes, **options), known, CODEC)
    assert placed is not None
    return np.asarray(placed.agents), np.stack(digits_of(np.asarray(agent_kinds(placed, CODEC)), DIGITS), 1)


def test_agents_of_a_crossing_road_drive_along_the_road_that_is_there():
    agents, digits = _settled([agent(20, -15, 90, 8)], [lane((20, -32), (20, 32))])
    assert digits[1, 3] == 1, "in the middle of a lane and along it"
    assert digits[1, 1] == 2 and abs(agents[1, 5]) < 1e-6, "as fast as before, and no longer across"


def test_agents_stay_as_they_are_where_the_lanes_have_such_places():
    others = [agent(-25, 0, 0, 8), agent(14, 0, 0, 0), agent(12, 4, 180, 15)]
    _, digits = _settled(others, ROAD.lanes)
    before = np.stack(digits_of(_kinds(others, ROAD.lanes), DIGITS), 1)
    assert sorted(map(tuple, digits)) == sorted(map(tuple, before))


def test_agents_are_apart_and_in_order_along_x():
    agents, _ = _settled([agent(x, 0, 0, 8) for x in (8, 14, 20, 26, -8, -14, -20, -26)], ROAD.lanes)
    assert not np.triu(overlaps(agents), 1).any() and (np.diff(agents[1:, 0]) >= -0.5).all()


def test_people_stay_off_the_lanes():
    _, digits = _settled([agent(12, -9, 90, 1, PERSON)], ROAD.lanes, types=[AgentType.VEHICLE, AgentType.PEDESTRIAN])
    assert digits[1, 0] == CODEC.agent_types.index(AgentType.PEDESTRIAN) and digits[1, 3] == 0


def test_open_kinds_and_scenes_without_lanes_are_left_to_the_network():
    kinds, rng = _kinds([agent(20, 0)], ROAD.lanes), np.random.default_rng(0)
    assert settle_agents(rng, np.append(kinds, NO_KIND), ROAD, CODEC) is None
    assert settle_agents(rng, kinds, scene([agent(0, 0)]), CODEC) is None


def test_vehicles_move_to_the_nearest_lane_of_their_direction():
    placed = scene([agent(0, 0), agent(12, 3.5, 20, 8), agent(-20, 5, 175, 8)], ROAD.lanes)
    agents = np.asarray(keep_to_lanes(placed, np.array([False, True, True])).agents)
    np.testing.assert_allclose(agents[1, [0, 1, 4, 5]], [12, 0.5, 1, 0], atol=1e-5)
    np.testing.assert_allclose(agents[2, :2], [-20, 4.5], atol=1e-5)
    np.testing.assert_array_equal(agents[2, 3:], placed.agents[2, 3:])


def test_vehicles_stay_where_no_lane_of_theirs_is_near_or_somebody_is_there():
    others = [agent(12, 9.5, 0, 8), agent(20, 2, 0, 8), agent(20, 0, 0, 8), agent(-20, 2, 90, 8)]
    placed = scene([agent(0, 0), *others], ROAD.lanes)
    kept = keep_to_lanes(placed, np.array([False, True, True, False, True]))
    np.testing.assert_array_equal(kept.agents, placed.agents)


def test_only_drivers_in_lanes_are_to_go_along_them():
    kinds = _kinds(
        [agent(12, 0), agent(20, 0, 180), agent(-20, 9), agent(-9, 0, 0, 1, PERSON)],
        ROAD.lanes,
        types=[*[AgentType.VEHICLE] * 4, AgentType.PEDESTRIAN],
    )
    assert along_lanes(np.append(kinds, NO_KIND), CODEC).tolist() == [True, True, False, False, False, False]
