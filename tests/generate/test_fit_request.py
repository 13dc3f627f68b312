"""Scenes are changed until they show what is requested: agents move, the ground inclines, the rest stays."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.generate.fit_agents import fit_agents
from scjax.generate.fit_slope import fit_slope
from scjax.language.analysis.scene_analysis import analyze
from scjax.language.attributes.table import check_attributes, measure_attributes, score_attributes
from scjax.metrics.realism import overlapping_pairs
from scjax.scene import AgentType, pad
from tests.factories.traffic import agent, lane, scene

PERSON = (0.6, 0.6, 1.7)
LANES = [lane((-32, 0), (32, 0)), lane((-32, 3.5), (32, 3.5)), lane((32, 7), (-32, 7))]


def _traffic():
    """The ego, six cars and a person on a road of two lanes one way and one the other."""
    cars = [agent(x, 3.5, 0, 6) for x in (-25, -12, 12, 25)] + [agent(x, 7, 180, 6) for x in (-15, 15)]
    types = [AgentType.VEHICLE] * 7 + [AgentType.PEDESTRIAN]
    return scene([agent(0, 0, 0, 6), *cars, agent(10, -6, 0, 1, PERSON)], LANES, types=types)


@pytest.mark.parametrize(
    "request_",
    [
        {"ahead": 2, "behind": 1},
        {"gap_ahead": (10, 14)},
        {"left_lane": 0, "oncoming": 3},
        {"parked": 2},
        {"queue": True},
        {"pedestrians_on_road": 1},
        *({"event": name} for name in ("wrong-way", "jaywalker", "stopped-in-lane", "double-parking", "cut-in")),
        {"event": "emergency-corridor"},
    ],
    ids=str,
)
def test_agents_are_moved_until_the_request_holds(request_):
    before, request = _traffic(), check_attributes(request_)
    assert score_attributes(before, request).misses
    after = fit_agents(before, request)
    assert not score_attributes(after, request).misses
    assert not len(overlapping_pairs(after))
    np.testing.assert_array_equal(after.lanes, before.lanes)
    np.testing.assert_array_equal(after.agents[0], before.agents[0])
    np.testing.assert_array_equal(after.agents[:, 6:], before.agents[:, 6:])


def test_scenes_that_show_the_request_stay():
    before = _traffic()
    assert fit_agents(before, check_attributes({"left_lane": (2, None), "vehicles": 3})) is before


def test_known_agents_stay():
    before = _traffic()
    after = fit_agents(before, check_attributes({"ahead": 2}), known=5)
    np.testing.assert_array_equal(after.agents[:5], before.agents[:5])
    assert measure_attributes(after)["ahead"] == 2


def test_agents_that_cannot_help_stay():
    before = scene([agent(0, 0, 0, 6), agent(10, -6, 0, 1, PERSON)], LANES, types=[0, 1])
    np.testing.assert_array_equal(fit_agents(before, check_attributes({"ahead": 2})).agents, before.agents)


@pytest.mark.parametrize("name", ["up", "down"])
def test_ground_inclines_as_requested(name):
    before = _traffic()
    after = fit_slope(before, {"slope": name})
    assert measure_attributes(after)["slope"] == (name,)
    np.testing.assert_array_equal(after.lanes[..., :2], before.lanes[..., :2])
    ground = after.agents[:, 2] - after.agents[:, 8] / 2
    np.testing.assert_allclose(ground[1], np.interp(after.agents[1, 0], *after.lanes[1, :, [0, 2]]), atol=1e-3)


def test_padding_stays():
    padded = pad(_traffic(), 12, 6)
    after = fit_agents(fit_slope(padded, {"slope": "up"}), check_attributes({"ahead": 2}))
    assert not after.agents[8:].any() and not after.lanes[3:].any()
    assert measure_attributes(after)["ahead"] == 2 and measure_attributes(after)["slope"] == ("up",)


def test_ground_that_is_as_requested_stays():
    before = _traffic()
    assert fit_slope(before, {"slope": "flat"}) is before and fit_slope(before, {}) is before


def test_analysis_of_moved_agents_is_that_of_their_scene():
    before, after = _traffic(), fit_agents(_traffic(), check_attributes({"ahead": 2}))
    moved = analyze(before).moved(analyze(after).agents)
    assert measure_attributes(moved) == measure_attributes(after)
