"""Ends of lanes inside the window that lead nowhere."""

from __future__ import annotations

from scjax.metrics.loose_ends import count_loose_ends
from tests.factories.traffic import crossing, lane, scene


def test_lanes_through_the_window_have_no_loose_ends():
    assert count_loose_ends(crossing()) == 0
    assert count_loose_ends(scene()) == 0


def test_starts_and_ends_inside_are_loose():
    assert count_loose_ends(scene(lanes=[lane((-10, 0), (10, 0))])) == 2
    assert count_loose_ends(scene(lanes=[lane((-32, 0), (10, 0))])) == 1


def test_ends_that_meet_are_not_loose():
    assert count_loose_ends(scene(lanes=[lane((-32, 0), (0, 0)), lane((0.5, 0), (32, 0))])) == 0


def test_dead_ends_have_a_way_back():
    assert count_loose_ends(scene(lanes=[lane((-32, 0), (10, 0)), lane((10, 3.5), (-32, 3.5))])) == 0
