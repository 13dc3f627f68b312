import itertools

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scjax.language.attributes.draw import draw_attributes
from scjax.language.attributes.table import (
    ATTRIBUTES,
    check_attributes,
    check_measurements,
    measure_attributes,
    score_attributes,
)
from scjax.language.attributes.vector import feature_names, request_vector
from scjax.scene.scene import empty
from scjax.synthetic.world import make_world
from tests.factories.synthetic_scenes import scenes_of

NAMES = feature_names()
counts = st.integers(0, 100)


def _vector(**request):
    return request_vector(request, NAMES)


def test_features_have_different_names():
    assert len(set(NAMES)) == len(NAMES)


def test_a_request_for_nothing_is_zero():
    assert not _vector().any() and not _vector(vehicles=(0, None), layout=None).any()


@given(st.tuples(counts, counts).map(sorted), st.tuples(counts, counts).map(sorted))
def test_different_ranges_are_different_vectors(first, second):
    same = np.array_equal(_vector(vehicles=first), _vector(vehicles=second))
    assert same == (first == second)


@given(counts, counts)
def test_a_larger_number_sets_more_of_the_thermometer(first, second):
    low, high = sorted((first, second))
    assert (_vector(vehicles=(low, None)) <= _vector(vehicles=(high, None))).all()
    assert (_vector(vehicles=(0, high)) <= _vector(vehicles=(0, low))).all()


def test_values_are_features_of_their_own():
    vector = _vector(layout="T", one_way=False, event=["cut-in", "work-zone"])
    assert {NAMES[k] for k in np.flatnonzero(vector)} == {
        "layout=T",
        "one_way=false",
        "event=cut-in",
        "event=work-zone",
    }
    assert set(vector.tolist()) == {0.0, 1.0}


def test_features_that_a_model_does_not_have_are_left_out():
    names = [name for name in NAMES if not name.startswith("layout=")]
    assert not request_vector({"layout": "T"}, names).any()


def test_an_unknown_value_is_refused():
    with pytest.raises(ValueError, match="layout has no value 'X'"):
        _vector(layout="X")


def test_measurements_of_a_scene_without_lanes_are_read_and_nothing_is_requested_of_its_road():
    measured = measure_attributes(empty(1, 0))
    assert check_measurements(msgspec.json.decode(msgspec.json.encode(measured))) == measured
    rng = np.random.default_rng(0)
    assert not any("one_way" in draw_attributes(measured, rng) for _ in range(100))


def test_scenes_fulfill_the_requests_that_are_drawn_from_them():
    rng = np.random.default_rng(0)
    requests = []
    for _, scene in itertools.islice(scenes_of(make_world(7, 0)), 6):
        measured = measure_attributes(scene)
        for _ in range(40):
            request = draw_attributes(measured, rng)
            assert check_attributes(request) == request
            misses = {k: v for k, v in request.items() if not ATTRIBUTES[k].holds(v, measured[k])}
            assert not misses
            assert all(request_vector({name: value}, NAMES).any() for name, value in request.items())
            requests.append(request)
        assert score_attributes(scene, requests[-1]).share == 1.0
    sizes = [len(request) for request in requests]
    assert min(sizes) == 0 and max(sizes) > len(ATTRIBUTES) / 2
    assert {name for request in requests for name in request} > {"layout", "vehicles", "one_way", "lanes_same"}
