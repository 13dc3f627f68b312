"""The study of placement on scenes made by hand."""

from __future__ import annotations

import numpy as np

from experiments.studies.placement import gain, measure, on_lanes, only_vehicles, request_of
from scjax.scene import AgentType
from tests.factories.traffic import agent, lane, scene
from tests.factories.worlds import tiny_model

LANES = [lane((-30, 0), (30, 0)), lane((30, 4), (-30, 4))]
SCENES = [scene([agent(0, 0), agent(x, 0), agent(-x, 4, 180)], LANES) for x in (10, 15, 20)]


def test_real_scenes_match_themselves_and_have_no_faults():
    values = measure(SCENES, SCENES, ["a", "b", "b"], seed=0)
    assert values["match"] == values["recall_1m"] == [1.0, 0.0]
    assert values["vehicles_overlapping"] == values["off_lane"] == values["off_heading"] == [0.0, 0.0]


def test_faults_are_counted():
    wrong = [scene([agent(0, 0), agent(-30, 0, 180), agent(-30, 9)], LANES) for _ in SCENES]
    values = measure(SCENES, wrong, ["a", "b", "c"], seed=0)
    assert [values[name][0] for name in ("match", "off_lane", "off_heading")] == [0.0, 0.5, 1.0]


def test_the_gain_over_others_is_the_difference_of_the_match_rates():
    wrong = [scene([agent(0, 0), agent(-30, 0), agent(one.agents[2, 0], 4)], LANES) for one in SCENES]
    assert gain(SCENES, SCENES, wrong, ["a", "b", "c"], seed=0) == [0.5, 0.0]
    assert gain(SCENES, wrong, SCENES, ["a", "b", "c"], seed=0) == [-0.5, 0.0]


def test_requests_have_the_number_of_vehicles():
    people = scene([agent(0, 0), agent(9, 0), agent(5, 9)], LANES, types=[0, 0, int(AgentType.PEDESTRIAN)])
    one, model = only_vehicles(people), tiny_model()
    for said in ("number", "attributes"):
        condition = request_of(one, model, said)
        assert (condition.num_agents, condition.num_lanes) == (2, 2) and condition.known is not None
        assert condition.attributes["vehicles"] == (1, 1) and condition.known.num_agents == 1
        assert ("ahead" in condition.attributes) == (said == "attributes") and "layout" not in condition.attributes
    assert all(len(placed.agents) == 3 for placed in on_lanes(SCENES, 0))
    assert not np.array_equal(on_lanes(SCENES, 0)[0].agents, on_lanes(SCENES, 1)[0].agents)
