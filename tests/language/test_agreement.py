"""Agreement of facts: a copy agrees fully, F1 is what it says, unknown signals count nowhere."""

import dataclasses

import pytest

from scjax.language.agreement import BINARY_ATTRIBUTES, CATEGORICAL_ATTRIBUTES, fact_agreement
from scjax.language.facts import Facts, Traffic
from scjax.metrics.pooling import pool, values

QUIET = Facts("straight", lanes_same=2)
BUSY = Facts(
    "four-way", intersection="four-way", lanes_same=2, lanes_opposite=2, turn_lanes=("left",), signals="red",
    side_streets_left=1, traffic=Traffic(vehicles=9, pedestrians=3, cyclists=1, ahead=2, oncoming=1, parked=1),
)  # fmt: skip


def test_a_copy_agrees_fully():
    shown = values(fact_agreement(BUSY, BUSY))
    assert len(shown) == len(BINARY_ATTRIBUTES) + 1 + len(CATEGORICAL_ATTRIBUTES) + 3
    assert set(shown.values()) == {1.0}


def test_f1_of_three_scenes():
    """Said in two, shown in two, both in one: F1 1/2."""
    pairs = [(BUSY, BUSY), (BUSY, QUIET), (QUIET, BUSY)]
    shown = values(pool(fact_agreement(*pair) for pair in pairs))
    for name in BINARY_ATTRIBUTES:
        assert shown[f"{name} F1"] == pytest.approx(1 / 2), name
    assert shown["red light F1"] == pytest.approx(2 / 3)  # the third reference records no signal
    assert shown["layout same"] == shown["vehicles within 1"] == pytest.approx(1 / 3)


def test_counts_may_be_off_by_one():
    near = dataclasses.replace(BUSY, lanes_same=3, traffic=dataclasses.replace(BUSY.traffic, vehicles=7))
    shown = values(fact_agreement(BUSY, near))
    assert shown["lanes within 1"] == 1 and shown["vehicles within 1"] == 0
