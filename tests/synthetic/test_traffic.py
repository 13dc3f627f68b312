"""Traffic simulation: speeds and gaps, lane changes of the network, signals and right of way."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scjax.scene import Signal
from scjax.synthetic import actors
from scjax.synthetic.domains import DOMAINS
from scjax.synthetic.junctions import InfeasiblePlan
from scjax.synthetic.lane_arrays import build_lane_arrays
from scjax.synthetic.network import Lane, Network
from scjax.synthetic.plan import build_network
from scjax.synthetic.signals import SignalTiming
from scjax.synthetic.stage import moment_times
from scjax.synthetic.street_plans import plan_intersection
from scjax.synthetic.traffic import TIME_STEP, Fleet, Obstacle, TrafficSimulation, draw_fleet
from scjax.synthetic.traffic.fleet import AXLE_SHARE


def vehicle(lane: int, along: float, speed: float, next_lane: int = -1, speed_factor: float = 1.0) -> dict:
    return {
        "lane": lane,
        "along": along,
        "speed": speed,
        "next_lane": next_lane,
        "previous_lane": -1,
        "granted": -1,
        "sizes": (4.5, 2.0, 1.5),
        "speed_factor": speed_factor,
        "lateral": 0.0,
        "lateral_goal": 0.0,
        "lateral_speed": 0.8,
        "entries": 0,
    }


def make_fleet(*vehicles: dict) -> Fleet:
    return Fleet(**{name: np.array([one[name] for one in vehicles]) for name in vehicles[0]})


def straight_network(*lengths: float) -> Network:
    """Lanes in a row along x."""
    net, start = Network(), 0.0
    for length in lengths:
        points = np.stack([np.linspace(start, start + length, 20), np.zeros(20)], -1)
        lane = net.add_lane(Lane(points, 15.0))
        if lane:
            net.link(lane - 1, lane)
        start += length
    return net


def make_simulation(net: Network, fleet: Fleet) -> TrafficSimulation:
    return TrafficSimulation(build_lane_arrays(net), [], fleet, np.random.default_rng(0))


def test_free_vehicle_reaches_speed_of_lane():
    simulation = make_simulation(straight_network(1000.0), make_fleet(vehicle(0, 10.0, 0.0)))
    simulation.run(40.0)
    assert simulation.fleet.speed[0] == pytest.approx(15.0, abs=0.3)


def test_followers_stop_behind_a_stopped_vehicle():
    fleet = make_fleet(vehicle(0, 300.0, 0.0, speed_factor=1e-3), vehicle(0, 100.0, 15.0), vehicle(0, 60.0, 15.0))
    simulation = make_simulation(straight_network(400.0), fleet)
    simulation.run(60.0)
    gaps = -np.diff(fleet.along) - 4.5
    assert (fleet.speed < 0.2).all() and (gaps > 0.2).all() and (gaps < 4.0).all()


def test_vehicle_moves_from_lane_to_lane():
    simulation = make_simulation(straight_network(50.0, 50.0, 500.0), make_fleet(vehicle(0, 10.0, 10.0, next_lane=1)))
    simulation.run(15.0)
    assert simulation.fleet.lane[0] == 2


@pytest.fixture(scope="module")
def intersection() -> tuple[Network, SignalTiming]:
    """A four-way intersection with signals, and their timing."""
    rng = np.random.default_rng(5)
    style = dataclasses.replace(DOMAINS[0].style, branches=(1.0,))
    while True:
        try:
            net = build_network(plan_intersection(style, rng), rng)
        except InfeasiblePlan:
            continue
        if net.junctions[0].phases and len(net.junctions[0].arms) == 4:
            return net, SignalTiming.draw(net.junctions[0], moment_times(), rng)


def dense_simulation(net: Network, timing: SignalTiming, seed: int) -> TrafficSimulation:
    rng = np.random.default_rng(seed)
    lanes = build_lane_arrays(net)
    fleet = draw_fleet(lanes, np.full(len(net.lanes), 0.02), lambda count: actors.draw_vehicle_sizes(count, rng), rng)
    return TrafficSimulation(lanes, [timing], fleet, rng)


def test_signals_show_all_states_and_repeat(intersection):
    _, timing = intersection
    cycle = sum(timing.green_times) + 5.0 * len(timing.green_times)
    states: dict[int, set] = {}
    for time in np.arange(0.0, cycle, 0.5):
        for lane, state in timing.states(float(time)).items():
            states.setdefault(lane, set()).add(state)
    assert all(values == {Signal.GO, Signal.CAUTION, Signal.STOP} for values in states.values())
    assert timing.states(3.0) == timing.states(3.0 + cycle)


def test_moments_show_yellow_and_green_often(intersection):
    net, _ = intersection
    rng = np.random.default_rng(6)
    shown = [
        set(SignalTiming.draw(net.junctions[0], moment_times(), rng).states(float(time)).values())
        for _ in range(200)
        for time in moment_times()
    ]
    shares = [np.mean([state in states for states in shown]) for state in (Signal.CAUTION, Signal.GO)]
    assert min(shares) > 0.35 and max(shares) < 0.65


def test_vehicles_obey_signals_and_do_not_collide(intersection):
    net, timing = intersection
    simulation = dense_simulation(net, timing, seed=1)
    fleet = simulation.fleet
    signal_lanes = [lane for phase in timing.phases for lane in phase]
    num_entries, distance = 0, 0.0
    for _ in range(240):
        lanes_before, signals_before = fleet.lane.copy(), simulation.signals.copy()
        simulation.run(TIME_STEP)
        for k in np.flatnonzero((fleet.lane != lanes_before) & np.isin(fleet.lane, signal_lanes)):
            num_entries += 1
            assert signals_before[fleet.lane[k]] != Signal.STOP
        distance += fleet.speed.sum() * TIME_STEP
        on_map = np.flatnonzero(fleet.lane >= 0)
        order = on_map[np.lexsort((fleet.along[on_map], fleet.lane[on_map]))]
        same_lane = fleet.lane[order][1:] == fleet.lane[order][:-1]
        half_length = fleet.sizes[order, 0] / 2
        gap = np.diff(fleet.along[order]) - half_length[1:] - half_length[:-1]
        assert (gap[same_lane] > 0).all()
    assert num_entries > 20 and distance > 2000
    num_grants = np.zeros(len(simulation.lanes.length), int)
    np.add.at(num_grants, fleet.granted[fleet.granted >= 0], 1)
    np.testing.assert_array_equal(num_grants, simulation.right_of_way.num_grants)


def test_conflicting_connectors_are_never_occupied_together(intersection):
    net, timing = intersection
    simulation = dense_simulation(net, timing, seed=2)
    fleet, lanes = simulation.fleet, simulation.lanes
    simulation.run(10.0)
    for _ in range(100):
        simulation.run(TIME_STEP)
        occupied = np.unique(fleet.lane[(fleet.lane >= 0) & (lanes.junction[fleet.lane] >= 0)])
        assert not lanes.conflicts[np.ix_(occupied, occupied)].any()


def two_lanes(length: float = 600.0) -> Network:
    """Two lanes abreast along x."""
    net = Network()
    for y in (3.5, 0.0):
        net.add_lane(Lane(np.stack([np.linspace(0, length, 60), np.full(60, y)], -1), 15.0))
    net.set_neighbors(0, 1)
    return net


def test_vehicles_pass_a_slow_one_on_the_other_lane():
    fleet = make_fleet(vehicle(1, 150.0, 2.0, speed_factor=0.1), vehicle(1, 100.0, 12.0), vehicle(1, 60.0, 12.0))
    simulation = make_simulation(two_lanes(), fleet)
    simulation.run(20.0)
    assert (fleet.lane[1:] == 0).all() and (fleet.along[1:] > fleet.along[0]).all()
    assert np.abs(fleet.lateral).max() < 0.5


def test_vehicles_keep_behind_obstacles_or_leave_the_lane():
    for net, passes in ((two_lanes(), True), (straight_network(600.0), False)):
        lane = 1 if passes else 0
        fleet = make_fleet(vehicle(lane, 100.0, 10.0))
        simulation = make_simulation(net, fleet)
        simulation.obstacles = (Obstacle(lane, 300.0),)
        for _ in range(60):
            simulation.run(TIME_STEP)
            assert fleet.lane[0] != lane or fleet.along[0] < 300.0 - 2.2
        assert (fleet.along[0] > 300.0) == passes


def test_axles_of_long_vehicles_keep_to_their_lane():
    angle = np.linspace(0, np.pi / 2, 40)
    net = Network()
    net.add_lane(Lane(20.0 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1), 8.0))
    fleet = make_fleet(vehicle(0, 15.0, 5.0))
    fleet.sizes[0, 0] = 12.0
    lanes = build_lane_arrays(net)
    (position,), (heading,) = fleet.poses(lanes, np.array([0]))
    reach = AXLE_SHARE * 12.0 * np.array([np.cos(heading), np.sin(heading)])
    for axle in (position + reach, position - reach):
        assert abs(np.hypot(axle[0], axle[1] - 20.0) - 20.0) < 0.3
