from __future__ import annotations

import numpy as np
import pytest

from scjax.scene import Signal
from scjax.synthetic import actors
from scjax.synthetic.domains import DOMAINS
from scjax.synthetic.network import Lane, Network
from scjax.synthetic.plan import build
from scjax.synthetic.signals import Timing
from scjax.synthetic.towns import crossing
from scjax.synthetic.tracks import track
from scjax.synthetic.traffic import DT, Fleet, Simulation, fill


def car(lane: int, at: float, speed: float, after: int = -1, pace: float = 1.0) -> dict:
    return {"lane": lane, "at": at, "speed": speed, "after": after, "holds": -1, "sizes": (4.5, 2.0, 1.5),
            "pace": pace, "aside": 0.0}  # fmt: skip


def fleet(*cars: dict) -> Fleet:
    return Fleet(**{name: np.array([one[name] for one in cars]) for name in cars[0]})


def straight(*lengths: float) -> Network:
    """Lanes one after the other along x."""
    net, start = Network(), 0.0
    for length in lengths:
        points = np.stack([np.linspace(start, start + length, 20), np.zeros(20)], -1)
        lane = net.add(Lane(points, 15.0))
        if lane:
            net.join(lane - 1, lane)
        start += length
    return net


def simulation(net: Network, cars: Fleet, timings=()) -> Simulation:
    return Simulation(track(net), list(timings), cars, np.random.default_rng(0))


def test_a_free_vehicle_reaches_its_speed():
    run = simulation(straight(1000.0), fleet(car(0, 10.0, 0.0)))
    run.run(40.0)
    assert run.fleet.speed[0] == pytest.approx(15.0, abs=0.3)


def test_followers_stop_behind_who_stands():
    run = simulation(straight(400.0), fleet(car(0, 300.0, 0.0, pace=1e-3), car(0, 100.0, 15.0), car(0, 60.0, 15.0)))
    run.run(60.0)
    gaps = -np.diff(run.fleet.at) - 4.5
    assert (run.fleet.speed < 0.2).all() and (gaps > 0.2).all() and (gaps < 4.0).all()


def test_a_vehicle_passes_from_lane_to_lane():
    run = simulation(straight(50.0, 50.0, 500.0), fleet(car(0, 10.0, 10.0, after=1)))
    run.run(15.0)
    assert run.fleet.lane[0] == 2


@pytest.fixture(scope="module")
def town():
    """A signalised crossing, with its lights."""
    rng = np.random.default_rng(5)
    style = DOMAINS[0].style
    while True:
        net = build(crossing(style, rng), rng)
        if net.junctions[0].phases and len(net.junctions[0].arms) == 4:
            return net, Timing.drawn(net.junctions[0], rng)


def test_lights_go_round(town):
    _, timing = town
    cycle = sum(timing.greens) + 5.0 * len(timing.greens)
    seen: dict[int, set] = {}
    for time in np.arange(0.0, cycle, 0.5):
        for lane, state in timing.states(float(time)).items():
            seen.setdefault(lane, set()).add(state)
    assert all(states == {Signal.GO, Signal.CAUTION, Signal.STOP} for states in seen.values())
    assert timing.states(3.0) == timing.states(3.0 + cycle)


def test_nobody_runs_a_red_light_or_into_another(town):
    net, timing = town
    rng = np.random.default_rng(1)
    tracks = track(net)
    cars = fill(tracks, np.full(len(net.lanes), 0.02), lambda n: actors.vehicle_sizes(n, rng), rng)
    run = Simulation(tracks, [timing], cars, rng)
    lit = {lane for phase in timing.phases for lane in phase}
    entered, moved = 0, 0.0
    for _ in range(240):
        before, lights = run.fleet.lane.copy(), run.lights.copy()
        run.run(DT)
        for k in np.flatnonzero((run.fleet.lane != before) & np.isin(run.fleet.lane, list(lit))):
            entered += 1
            assert lights[run.fleet.lane[k]] != Signal.STOP
        moved += run.fleet.speed.sum() * DT
        on = np.flatnonzero(run.fleet.lane >= 0)
        order = on[np.lexsort((run.fleet.at[on], run.fleet.lane[on]))]
        same = run.fleet.lane[order][1:] == run.fleet.lane[order][:-1]
        half = run.fleet.sizes[order, 0] / 2
        gap = np.diff(run.fleet.at[order]) - half[1:] - half[:-1]
        assert (gap[same] > 0).all()
    assert entered > 20 and moved > 2000
    held = np.zeros(len(tracks.length), int)
    np.add.at(held, run.fleet.holds[run.fleet.holds >= 0], 1)
    np.testing.assert_array_equal(held, run._held)


def test_connectors_that_cross_are_never_driven_at_once(town):
    net, timing = town
    rng = np.random.default_rng(2)
    tracks = track(net)
    cars = fill(tracks, np.full(len(net.lanes), 0.02), lambda n: actors.vehicle_sizes(n, rng), rng)
    run = Simulation(tracks, [timing], cars, rng)
    run.run(10.0)
    for _ in range(100):
        run.run(DT)
        used = np.unique(run.fleet.lane[(run.fleet.lane >= 0) & (tracks.junction[run.fleet.lane] >= 0)])
        assert not tracks.conflict[np.ix_(used, used)].any()
