"""Agreement of facts with a reference, and with labels of synthetic scenes."""

import dataclasses

import pytest

from scjax.language.agreement import BINARY_ATTRIBUTES, CATEGORICAL_ATTRIBUTES, fact_agreement, label_agreement
from scjax.language.facts import Facts, Traffic
from scjax.metrics.pooling import pool, values

QUIET = Facts("straight", lanes_same=2)
BUSY = Facts(
    "four-way",
    intersection="four-way",
    lanes_same=2,
    lanes_opposite=2,
    turn_lanes=("left",),
    signals="red",
    side_streets_left=1,
    traffic=Traffic(vehicles=9, pedestrians=3, cyclists=1, ahead=2, oncoming=1, parked=1),
)


def test_fact_agreement_of_a_copy_is_full():
    metrics = values(fact_agreement(BUSY, BUSY))
    assert len(metrics) == len(BINARY_ATTRIBUTES) + 1 + len(CATEGORICAL_ATTRIBUTES) + 3
    assert set(metrics.values()) == {1.0}


def test_fact_agreement_f1_of_three_scenes():
    """An attribute in two references, in two generated scenes, in both of one pair: F1 is 1/2."""
    pairs = [(BUSY, BUSY), (BUSY, QUIET), (QUIET, BUSY)]
    metrics = values(pool(fact_agreement(*pair) for pair in pairs))
    for name in BINARY_ATTRIBUTES:
        assert metrics[f"{name} F1"] == pytest.approx(1 / 2), name
    assert metrics["red light F1"] == pytest.approx(2 / 3)  # the third reference records no signal
    assert metrics["layout same"] == metrics["vehicles within 1"] == pytest.approx(1 / 3)


def test_fact_agreement_counts_may_be_off_by_one():
    similar = dataclasses.replace(BUSY, lanes_same=3, traffic=dataclasses.replace(BUSY.traffic, vehicles=7))
    metrics = values(fact_agreement(BUSY, similar))
    assert metrics["lanes within 1"] == 1 and metrics["vehicles within 1"] == 0


def test_label_agreement_counts_labels_and_matches():
    label = {"layout": "four-way", "signal": "red", "event": None}
    other = {"layout": "straight", "signal": None, "event": "jaywalker"}
    assert label_agreement([(label, BUSY), (label, QUIET), (other, QUIET)]) == {
        "curved or straight": (1, 1),
        "event: jaywalker": (0, 1),
        "intersection": (1, 2),
        "no other event": (3, 3),
        "signal": (1, 2),
    }
