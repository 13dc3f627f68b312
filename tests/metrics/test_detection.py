"""Average precision: one match an agent, what scores change, what lies outside the view."""

import math

import numpy as np
import pytest

from scjax.metrics.detection import average_precision, consensus, detections
from scjax.metrics.placement import camera, field_of_view, match
from scjax.scene import AgentType
from tests.factories.traffic import agent, scene

EGO = agent(0, 0)


def crowd(seed, count=9):
    rng = np.random.default_rng(seed)
    return [agent(*rng.uniform(-30, 30, 2)) for _ in range(count)]


def test_average_precision_of_copies_and_empty_scenes():
    pairs = [(scene([EGO, *crowd(k)]), scene([EGO, *crowd(k)])) for k in range(3)]
    perfect = average_precision(detections(*pair) for pair in pairs)
    assert perfect["nuscenes"] == pytest.approx(1) and perfect["interp101"] == pytest.approx(1)
    assert set(average_precision([detections(pairs[0][0], scene([EGO]))]).values()) == {0.0}
    assert all(math.isnan(v) for v in average_precision([detections(scene([EGO]), pairs[0][0])]).values())


def test_detections_count_duplicates_once():
    reference, generated = scene([EGO, agent(9, 0)]), scene([EGO, agent(9, 0), agent(9, 0)])
    assert detections(reference, generated).hit.sum(0).tolist() == [1, 1, 1]


def test_detections_match_in_order_of_score():
    reference = scene([EGO, agent(10, 0)])
    generated = scene([EGO, agent(12.5, 0), agent(10, 0)])
    first = detections(reference, generated, np.array([0.0, 2, 1]))
    assert first.hit.tolist() == [[False, False, True], [True, True, False]] and first.score.tolist() == [2, 1]
    last = detections(reference, generated, np.array([0.0, 1, 2]))
    assert last.hit.tolist() == [[True, True, True], [False, False, False]]


def test_random_scores_give_precision_times_recall():
    rng = np.random.default_rng(0)
    parts, matches, generated_count, reference_count = [], 0, 0, 0
    for seed in range(300):
        reference = crowd(seed)
        copies = [box for box in reference if rng.random() < 0.5]
        generated = scene([EGO, *copies, *(agent(*rng.uniform(-30, 30, 2)) for _ in range(5))])
        part = detections(scene([EGO, *reference]), generated, rng.random(len(generated.agents)))
        parts.append(part)
        matches, generated_count, reference_count = (
            matches + part.hit[:, 0].sum(),
            generated_count + len(part.score),
            reference_count + part.references,
        )
    product = matches / generated_count * matches / reference_count
    assert average_precision(parts)["interp101"] == pytest.approx(product, abs=0.1)


def test_average_precision_rises_with_matches():
    reference = scene([EGO, *crowd(1, 6)])
    some = crowd(1, 6)[:3]
    wrong = [agent(31, 31), agent(-31, 31)]
    values = [
        average_precision([detections(reference, scene([EGO, *boxes]))])["interp101"]
        for boxes in ([*some, *wrong], some, crowd(1, 6)[:4], crowd(1, 6))
    ]
    assert values == sorted(values) and values[0] <= values[1] < values[2] < values[3]


def test_consensus_is_the_share_of_agreeing_siblings():
    sample = scene([EGO, agent(9, 0), agent(20, 0)])
    siblings = [
        scene([EGO, agent(10, 0)]),
        scene([EGO, agent(9, 1.5), agent(20, 3)]),
        scene([EGO, agent(9, 0)], types=[AgentType.VEHICLE, AgentType.CYCLIST]),
    ]
    np.testing.assert_allclose(consensus(sample, siblings)[1:], [2 / 3, 0])
    assert not consensus(sample, []).any()


def test_field_of_view_selects_agents_ahead():
    inside = field_of_view()
    positions = [[10, 0], [10, 11.9], [10, 11.95], [10, -11.9], [-1, 0], [0, 0]]
    assert inside(np.array(positions, float)).tolist() == [True, True, False, True, False, False]
    assert field_of_view(apex=5.0)(np.array([[4.0, 0], [6.0, 0]])).tolist() == [False, True]
    # Half a picture as wide as the focal length is long: 45 degrees to either side.
    assert camera(960.0, 1920.0, 1.0)(np.array([[11.0, 9.9], [11.0, 10.1], [0.5, 0.0]])).tolist() == [
        True,
        False,
        False,
    ]
    reference = scene([EGO, agent(9, 0), agent(-9, 0)])
    assert match(reference, reference, region=inside)["recall_1m"] == (1, 1)
    assert detections(reference, reference, region=inside).references == 1
