"""The reader's numbers and targets: what a request becomes, and what is read of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scjax.language.attributes.table import ATTRIBUTES, check_attributes
from scjax.language.grammar.compose import compose_freely
from scjax.language.grammar.phrasebook import languages
from scjax.language.reader.bounds import pair_scores
from scjax.language.reader.numbers import LARGEST, find_numbers, token_numbers
from scjax.language.reader.targets import (
    LEVELS,
    NAMED,
    RANGES,
    VALUES,
    read_outputs,
    request_targets,
    value_names,
)


def _read(request):
    """What is read where the network is sure of the targets."""
    targets = request_targets(request)
    ends = np.eye(LEVELS)[targets.ends]
    return read_outputs(20 * targets.named - 10, 20 * ends - 10)


def _requests():
    """Requests in their normal form whose numbers the tables hold."""

    def bounds(attribute):
        low, high = attribute.limits[0], min(attribute.limits[1], LEVELS - 2)
        numbers = st.integers(low, high)
        closed = st.tuples(numbers, numbers).map(lambda ends: (min(ends), max(ends)))
        return closed | st.integers(max(low, 1), high).map(lambda least: (least, None))

    kinds = {
        "choice": lambda attribute: st.sampled_from(attribute.values),
        "flag": lambda attribute: st.booleans(),
        "set": lambda attribute: st.sets(st.sampled_from(attribute.values), min_size=1).map(attribute.check),
        "range": bounds,
    }
    fields = {name: kinds[attribute.kind](attribute) for name, attribute in ATTRIBUTES.items()}
    return st.fixed_dictionaries({}, optional=fields)


@given(_requests())
def test_reading_is_the_inverse_of_targets(request):
    request = {name: value for name, value in request.items() if value != (1, None) or name != "ego_lane_index"}
    if request.get("one_way") and "lanes_same" not in request:
        request.pop("lanes_total", None)
    reading = _read(request)
    assert reading.request == request and reading.shares.keys() == request.keys()
    assert all(0.9 < share <= 1 for share in reading.shares.values())


@given(st.integers(0, 2**32 - 1))
def test_whatever_the_network_says_is_a_request(seed):
    rng = np.random.default_rng(seed)
    named, ends = 5 * rng.normal(size=(len(NAMED), VALUES)), 5 * rng.normal(size=(len(RANGES), 2, LEVELS))
    reading = read_outputs(named, ends)
    assert check_attributes(reading.request) == reading.request


@pytest.mark.parametrize(("margin", "is_likely"), [(-0.5, None), (2.9, True), (3.1, False)])
def test_attributes_that_are_nearly_as_likely_as_none_are_likely(margin, is_likely):
    """``margin``: by how much the logit of "unspecified" is higher; below 0 the attribute is read."""
    targets = request_targets({})
    named, ends = 20 * (targets.named - 1.0), 20 * (np.eye(LEVELS)[targets.ends] - 1.0)
    row = [attribute.name for attribute in NAMED].index("slope")
    place = value_names(NAMED[row]).index("up")
    named[row, place] = named[row, 0] - margin
    vehicles = [attribute.name for attribute in RANGES].index("vehicles")
    ends[vehicles, 0, 3] = ends[vehicles, 0, 0] - margin
    reading, expected = read_outputs(named, ends, [3]), {"slope": "up", "vehicles": (3, None)}
    assert reading.request == (expected if is_likely is None else {})
    assert reading.likely == (expected if is_likely else {})


def test_nothing_is_read_of_nothing():
    assert _read({}) == ({}, {}, {})


def test_numbers_beyond_the_table_are_its_last():
    assert _read({"vehicles": (90, 100)}).request["vehicles"] == (LEVELS - 1, LEVELS - 1)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("twelve cars, 3 people", [12, 3]),
        ("deux voitures et vingt piétons", [2, 20]),
        ("三台车", [3]),
        ("十二人の歩行者", [12]),
        ("حافلتان و ثلاثة سيارات", [3]),
        ("someone, a tent and an often", []),
        ("4-way, 50000 cars", [4, 50000]),
    ],
)
def test_numbers_of_all_languages(text, expected):
    assert [value for *_, value in find_numbers(text)] == expected


def test_composed_numbers_are_found():
    """What the grammar states as a number word is found, in every language."""
    rng = np.random.default_rng(0)
    for code in languages():
        found = sum(bool(list(find_numbers(compose_freely(rng, language=code).text))) for _ in range(40))
        assert found > 5, code


def test_tokens_have_the_number_that_they_are_a_part_of():
    assert token_numbers("two or 4000", [(0, 0), (0, 2), (2, 3), (4, 6), (7, 9), (9, 11), (11, 11)]).tolist() == [
        *(0, 3, 3, 0),
        *(LARGEST + 1, LARGEST + 1, 0),
    ]


def test_ranges_begin_at_their_limits():
    """An open lower end is the least number that the attribute takes."""
    for attribute in RANGES:
        top = attribute.limits[0] + 5
        assert _read({attribute.name: (attribute.limits[0], top)}).request == {
            attribute.name: (attribute.limits[0], top)
        }


def test_pairs_of_ends_that_no_number_states_are_less_likely():
    """Both ends are read alone; the numbers of the text decide between pairs that are almost as likely."""
    logits = np.full((len(RANGES), 2, LEVELS), -9.0)
    logits[:, :, 0] = 9.0
    row = next(place for place, one in enumerate(RANGES) if one.name == "vehicles")
    logits[row] = -9.0
    logits[row, 0, [18, 19]] = 2.0, 2.5  # "about twenty": 17 to 23, "twenty": 19 to 21
    logits[row, 1, 24] = 2.0
    named = np.full((len(NAMED), VALUES), -9.0)
    named[:, 0] = 9.0
    assert read_outputs(named, logits).request["vehicles"] == (19, 23)
    logits[row, 0, [17, 18]] = 2.0, -9.0
    assert read_outputs(named, logits, [20]).request["vehicles"] == (17, 23)


def test_scores_allow_every_pair_in_order_and_no_other():
    scores = pair_scores([3, 70], "", LEVELS)
    least, end = np.indices(scores.shape)
    in_order = (end == 0) | (least < end) | (least + end == 2 * LEVELS - 2)  # the last: numbers beyond the table
    assert (np.isfinite(scores) == in_order).all()
    assert scores[3, 4] == scores[3, 0] == scores[0, 0] == 0 > scores[5, 6]
    assert pair_scores([20], "m", LEVELS)[15, 26] == 0


def test_all_lanes_of_a_one_way_road_run_with_the_ego():
    assert _read({"one_way": True, "lanes_total": (3, 3)}).request == {"one_way": True, "lanes_same": (3, 3)}
    both = {"one_way": True, "lanes_same": (2, 2), "lanes_total": (2, 3)}
    assert _read(both).request == both
    assert _read({"one_way": False, "lanes_total": (3, 3)}).request == {"one_way": False, "lanes_total": (3, 3)}
