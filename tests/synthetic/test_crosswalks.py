"""People on crosswalks, and the vehicles that wait for them."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.scene import Signal
from scjax.synthetic.crosswalks import CrosswalkWalkers, find_crosswalks
from scjax.synthetic.setting import draw_setting
from scjax.synthetic.traffic import TIME_STEP


@pytest.fixture(scope="module")
def settings() -> list:
    """Beginnings of worlds with crosswalks."""
    drawn = (draw_setting(21, k, event_share=0.0) for k in range(60))
    with_crosswalks = [one for one in drawn if len(find_crosswalks(one.net).start)]
    return sorted(with_crosswalks, key=lambda one: not one.stage.simulation.right_of_way.timings)[:4]


def test_crosswalks_cross_connectors_of_their_arm(settings):
    for setting in settings:
        crosswalks = find_crosswalks(setting.net)
        assert (crosswalks.arriving <= crosswalks.crossed).all()
        assert crosswalks.crossed.any(1).mean() > 0.8
        assert (crosswalks.length > 5.0).all()


def test_people_and_vehicles_never_meet_on_a_crosswalk(settings):
    num_on_road = 0
    for setting in settings:
        simulation, crosswalks = setting.stage.simulation, find_crosswalks(setting.net)
        walkers = CrosswalkWalkers(crosswalks, 2.0, np.random.default_rng(0))
        way, before = simulation.right_of_way, None
        for _ in range(120):
            walkers.step(TIME_STEP, way)
            on_road = (walkers.along >= 0) & (walkers.along <= crosswalks.length[walkers.crosswalk])
            used = walkers.in_the_way(on_road)
            if before is not None:  # who entered this step found the connectors free
                assert not (way.num_grants[used & ~before] > 0).any()
            simulation.step()
            assert not (way.num_grants[used] > 0).any()
            num_on_road, before = num_on_road + int(on_road.sum()), used
    assert num_on_road > 50


def test_people_wait_for_signals(settings):
    setting = next(one for one in settings if one.stage.simulation.right_of_way.timings)
    simulation, crosswalks = setting.stage.simulation, find_crosswalks(setting.net)
    walkers = CrosswalkWalkers(crosswalks, 2.0, np.random.default_rng(1))
    for _ in range(120):
        before = walkers.along.copy()
        green = (simulation.signals == Signal.GO)[None] & crosswalks.arriving
        walkers.step(TIME_STEP, simulation.right_of_way)
        entered = walkers.crosswalk[(before < 0) & (walkers.along >= 0)]
        assert not green[entered].any()
        simulation.step()
