from xml.etree import ElementTree

import numpy as np
import pytest

from scjax.towns.demand import KINDS, Demand, vehicle_sizes, write_demand
from scjax.towns.sumo_network import read_network
from tests.factories.town_traffic import write_net


@pytest.fixture
def network(tmp_path):
    return read_network(write_net(tmp_path))


def _routes(network, tmp_path, **changes):
    demand = Demand(**({"vehicles_per_km": 200.0, "people_per_km": 100.0, "seconds": 300.0, "seed": 3} | changes))
    return ElementTree.parse(write_demand(network, demand, tmp_path)).getroot()


def test_demand_is_sorted_and_on_known_edges(network, tmp_path):
    root = _routes(network, tmp_path)
    times = [float(item.get("depart", 0)) for item in root if item.tag != "vType"]
    assert times == sorted(times) and len(times) > 100
    edges = {lane.edge for lane in network.lanes.values() if not lane.is_internal}
    assert {trip.get("from") for trip in root.iter("trip")} <= edges
    assert {walk.get("from") for walk in root.iter("walk")} == {"-3"}


def test_types_have_the_sizes_that_boxes_get(network, tmp_path):
    sizes = vehicle_sizes(3)
    for item in _routes(network, tmp_path).iter("vType"):
        stated = tuple(float(item.get(name, 0)) for name in ("length", "width", "height"))
        assert stated == sizes[item.get("id", "")]
    assert set(sizes) == {item.get("id") for item in _routes(network, tmp_path).iter("vType")}


def test_every_kind_of_vehicle_comes(network, tmp_path):
    kinds = {trip.get("type", "").partition(".")[0] for trip in _routes(network, tmp_path).iter("trip")}
    assert kinds == set(KINDS)


def test_density_sets_the_number_of_vehicles(network, tmp_path):
    few, many = (
        len(list(_routes(network, tmp_path, vehicles_per_km=density).iter("trip"))) for density in (20.0, 200.0)
    )
    assert 8 < many / few < 12


def test_demand_depends_on_its_seed_alone(network, tmp_path):
    texts = [ElementTree.tostring(_routes(network, tmp_path, seed=seed)) for seed in (1, 1, 2)]
    assert texts[0] == texts[1] != texts[2]


def test_part_of_a_large_town_is_used(network, tmp_path):
    edges = {trip.get("from") for trip in _routes(network, tmp_path, most_km=0.1).iter("trip")}
    assert len(edges) == 1


def test_sizes_are_those_of_their_kind():
    for name, size in vehicle_sizes(5).items():
        kind = KINDS[name.partition(".")[0]]
        assert (np.abs(np.array(size) - kind.size) <= 2 * np.array(kind.deviation) + 0.01).all()
