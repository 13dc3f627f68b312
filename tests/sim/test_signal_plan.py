"""Phases of signals."""

from __future__ import annotations

import numpy as np

from scjax.scene import Signal
from scjax.sim.signal_plan import plan_signals


def test_no_approach_waits_for_more_than_two_others():
    angles = np.deg2rad(np.arange(0.0, 360.0, 36.0))
    places = 10.0 * np.stack([np.cos(angles), np.sin(angles)], -1)
    states = np.full(len(angles), Signal.STOP)
    states[0] = Signal.GO
    plan = plan_signals(places, angles + np.pi, states, np.random.default_rng(0))
    shown = plan.states(np.arange(0.0, 120.0, 0.5))
    for row in shown:
        red = np.diff(np.flatnonzero(np.concatenate([[True], row != Signal.STOP, [True]])))
        assert red.max() * 0.5 <= 34.0


def test_approaches_of_one_axis_are_green_together():
    places = np.array([[-10.0, 0.0], [10.0, 0.0], [0.0, -10.0]])
    headings = np.array([0.0, np.pi, np.pi / 2])
    states = np.array([Signal.GO, Signal.GO, Signal.STOP])
    shown = plan_signals(places, headings, states, np.random.default_rng(0)).states(np.arange(0.0, 60.0, 0.5))
    assert (shown[0] == shown[1]).all()
    assert not ((shown[0] == Signal.GO) & (shown[2] == Signal.GO)).any()
