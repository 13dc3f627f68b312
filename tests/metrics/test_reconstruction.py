"""Errors of a decoded twin: zero for a copy, exact for known changes, unknown values and padding left out."""

import math

import numpy as np
import pytest

from scjax.metrics.pooling import pool, values
from scjax.metrics.reconstruction import error_summary, reconstruction, reconstruction_errors
from scjax.scene import AgentType, Link, Signal, pad, permute
from tests.factories.traffic import agent, crossing, lane, scene

ERRORS = (
    "lane_point_m",
    "lane_z_m",
    "agent_centre_m",
    "agent_z_m",
    "heading_deg",
    "speed_mps",
    "length_m",
    "width_m",
    "height_m",
)
SCORES = ("agent_type_accuracy", "signal_accuracy", "link_f1", "link_f1_left", "link_f1_macro")


def lit():
    decoded = crossing()
    return decoded.replace(signals=np.array([Signal.STOP, Signal.UNKNOWN, Signal.GO], np.int32))


def test_reconstruction_of_a_copy_is_perfect():
    result = reconstruction([(lit(), lit())])
    assert all(result[name] == 0 for name in ERRORS)
    assert all(result[name] == 1 for name in SCORES)


def test_reconstruction_errors_of_known_changes():
    true = lit()
    agents, lanes = true.agents.copy(), true.lanes.copy()
    agents[1, :3] += [3, 4, 0.5]
    agents[1, 4:6] = [-1, 0]  # 180 degrees; of three agents besides the ego
    agents[2, 3] += 2
    agents[:, 6:9] += [0.4, 0.2, 0.1]
    lanes[0] += [0.3, 0.4, -0.6]
    result = true.replace(
        agents=agents, lanes=lanes, agent_types=np.array([0, 0, 1, 1], np.int32), signals=np.array([3, 3, 2], np.int32)
    )
    result = reconstruction([(true, result)])
    expected = {
        "agent_centre_m": 5 / 3,
        "agent_z_m": 0.5 / 3,
        "heading_deg": 60,
        "speed_mps": 0.5,
        "length_m": 0.4,
        "width_m": 0.2,
        "height_m": 0.1,
        "lane_point_m": 0.5 / 3,
        "lane_z_m": 0.2,
        "agent_type_accuracy": 0.75,
        "signal_accuracy": 0.5,
    }
    for name, value in expected.items():
        assert result[name] == pytest.approx(value, abs=1e-5), name


def test_reconstruction_heading_error_wraps():
    true, result = (scene([agent(0, 0), agent(5, 5, heading)]) for heading in (179, -179))
    assert reconstruction([(true, result)])["heading_deg"] == pytest.approx(2, abs=1e-4)


def test_reconstruction_link_f1():
    true = crossing()
    links = true.links.copy()
    links[0, 1], links[1, 0] = Link.NONE, Link.NONE  # one predecessor link missed
    links[2, 1], links[1, 2] = Link.PREDECESSOR, Link.SUCCESSOR  # a left link of two taken for a predecessor
    result = reconstruction([(true, true.replace(links=links))])
    assert result["link_f1"] == 0  # no hit, one true, one predicted
    assert result["link_f1_left"] == result["link_f1_right"] == pytest.approx(2 / 3)
    assert result["link_f1_macro"] == pytest.approx(4 / 9)


def test_reconstruction_macro_f1_skips_absent_links():
    plain = scene([agent(0, 0)], [lane((-9, 0), (0, 0)), lane((0, 0), (9, 0))], joined=[(0, 1)])
    result = reconstruction([(plain, plain)])
    assert math.isnan(result["link_f1_left"]) and result["link_f1_macro"] == 1


def test_reconstruction_ignores_unknown_values():
    true = lit()
    agent_known, lane_known = true.agent_known.copy(), true.lane_known.copy()
    agent_known[:, 6:9], agent_known[1, 2], lane_known[:, 2] = False, False, False
    agents, lanes = true.agents.copy(), true.lanes.copy()
    agents[:, 6:9] += 1
    agents[1, 2] += 7
    lanes[..., 2] += 5
    true = true.replace(agent_known=agent_known, lane_known=lane_known, signals=np.zeros(3, np.int32))
    result = reconstruction([(true, true.replace(agents=agents, lanes=lanes, signals=np.ones(3, np.int32)))])
    assert all(math.isnan(result[n]) for n in ("length_m", "width_m", "height_m", "lane_z_m", "signal_accuracy"))
    assert result["agent_z_m"] == 0 and reconstruction_errors(true, true)["agent_z_m"] == (0, 2)
    flat = lit()
    blind = flat.replace(lane_known=flat.lane_known & np.array([True, True, False]))  # a decoder without elevation
    assert math.isnan(reconstruction([(flat, blind)])["lane_z_m"])


def test_reconstruction_ignores_batching_and_padding():
    rng = np.random.default_rng(0)

    def pairs():
        local = np.random.default_rng(1)
        for _ in range(5):
            true = lit()
            yield true, true.replace(agents=true.agents + local.normal(0, 0.1, (4, 9)).astype(np.float32))

    stored = list(pairs())
    streamed = reconstruction(pairs())
    halves = [pool(reconstruction_errors(*pair) for pair in part) for part in (stored[:2], stored[2:])]
    for name, value in error_summary(pool(halves)).items():
        assert value == pytest.approx(streamed[name], rel=1e-12), name
    padded = reconstruction((pad(true, 9, 7), pad(result, 6, 5)) for true, result in stored)
    assert padded == pytest.approx(streamed)
    order, lanes = np.append(0, 1 + rng.permutation(3)), rng.permutation(3)
    shuffled = reconstruction((permute(true, order, lanes), permute(result, order, lanes)) for true, result in stored)
    assert shuffled == pytest.approx(streamed)


def test_reconstruction_needs_equal_element_counts():
    with pytest.raises(ValueError, match="matched by index"):
        reconstruction_errors(crossing(), scene([agent(0, 0)], types=[AgentType.VEHICLE]))
    assert math.isnan(values(reconstruction_errors(scene([agent(0, 0)]), scene([agent(0, 0)])))["agent_centre_m"])
