"""Agents relative to the ego, in scenes drawn by hand."""

from __future__ import annotations

import pytest

from scjax.language.facts import extract_facts
from scjax.language.traffic import Traffic
from scjax.scene import AgentType
from tests.factories.hand_drawn_scene import WIDTH
from tests.factories.road_scenes import intersection, straight_road


@pytest.fixture(scope="module")
def traffic() -> Traffic:
    builder = straight_road(2, 1, ego_index=2)
    for vehicle in ((15, 0), (-12, 0), (-20, 0), (8, WIDTH), (-20, 2 * WIDTH, 180, 5), (3, -6)):
        builder.add_agent(*vehicle)
    builder.add_agent(10, -9, agent_type=AgentType.PEDESTRIAN).add_agent(10, 12, agent_type=AgentType.PEDESTRIAN)
    builder.add_agent(4, -3, agent_type=AgentType.CYCLIST)
    return extract_facts(builder.scene()).traffic


def test_traffic_counts_agents_by_type(traffic):
    assert (traffic.vehicles, traffic.pedestrians, traffic.cyclists) == (6, 2, 1)


def test_traffic_counts_vehicles_by_lane(traffic):
    assert (traffic.ahead, traffic.behind, traffic.left_lane, traffic.right_lane) == (1, 2, 1, 0)
    assert (traffic.oncoming, traffic.crossing, traffic.parked, traffic.off_road) == (1, 0, 1, 1)


def test_traffic_counts_pedestrians_by_side(traffic):
    assert (traffic.pedestrians_left, traffic.pedestrians_right, traffic.pedestrians_near_road) == (1, 1, 1)


def test_traffic_ego_motion_in_words(traffic):
    assert traffic.ego_motion == "moderate"


def test_traffic_counts_crossing_vehicles():
    builder = intersection(20, 0, (0, 90, 180, -90))
    builder.add_agent(20 + WIDTH / 2, -20, 90, 6).add_agent(20 - WIDTH / 2, 25, -90, 6)
    assert extract_facts(builder.scene()).traffic.crossing == 2
