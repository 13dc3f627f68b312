"""Outlines of scenes: which scene fulfills a request, and draws of one."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from scjax.generate.outlines import ARRAYS, Outlines
from scjax.language.attributes.draw import draw_attributes
from scjax.language.attributes.table import ATTRIBUTES, check_attributes
from tests.factories.outlines import measurements, outlines

ROWS = [
    ((1, 2), (0, 1), {"layout": ("T", "intersection"), "vehicles": 1, "gap_ahead": 12.34}),
    ((1, 2, 3), (0, 1, 1), {"layout": ("T", "intersection"), "vehicles": 2, "signal": ("red",)}),
    ((1,), (0,), {"layout": ("straight",), "event": ("work-zone", "jaywalker"), "queue": True}),
]


def _draws(number=60, request=None, **options):
    rng, known = np.random.default_rng(0), outlines(*ROWS, domains=options.pop("domains", None))
    return {known.draw(rng, check_attributes(request or {}), **options) for _ in range(number)}


def test_scenes_hold_what_their_measurements_hold():
    known, rng = outlines(*ROWS), np.random.default_rng(0)
    for _ in range(50):
        request = draw_attributes(measurements(**ROWS[rng.integers(3)][2]), rng)
        expected = [
            sum(ATTRIBUTES[name].holds(value, measurements(**row[2])[name]) for name, value in request.items())
            for row in ROWS
        ]
        held = known.count_held(request)
        assert np.abs(held - expected).max() <= int("gap_ahead" in request)  # kept to 0.1 m
    assert known.count_held({"layout": "T", "event": ("jaywalker",)}).tolist() == [1, 1, 1]


def test_draws_show_most_of_the_request():
    assert _draws(request={"layout": "T"}) == {0, 1}
    assert _draws(request={"layout": "T", "signal": "red"}) == {1}
    assert _draws(request={"layout": "straight", "vehicles": 5}) == {2}
    assert _draws() == {0, 1, 2}


def test_likely_attributes_decide_between_scenes_that_show_the_request_equally():
    assert _draws(request={"layout": "T"}, likely=check_attributes({"signal": "red"})) == {1}
    assert _draws(request={"layout": "T"}, likely=check_attributes({"vehicles": 1})) == {0}
    assert _draws(likely=check_attributes({"layout": "straight"})) == {2}


def test_likely_attributes_never_outweigh_one_of_the_request():
    likely = check_attributes({"queue": True, "event": ("jaywalker",), "vehicles": (0, 1)})
    assert _draws(request={"layout": "T", "signal": "red"}, likely=likely) == {1}


def test_numbers_of_agents_decide_after_all_else():
    rows = [
        ((1,), (0, 1), {"layout": ("straight",), "vehicles": 3, "pedestrians": 2}),
        ((1,), (0, 1), {"layout": ("roundabout",), "vehicles": 1, "pedestrians": 1}),
    ]
    request = check_attributes({"layout": "roundabout", "vehicles": 3, "pedestrians": 2})
    assert outlines(*rows).draw(np.random.default_rng(0), request) == 1


def _tried(known, trials):
    """Outlines with trials (changed measurements, faults) of every row."""
    return known.with_trials(
        [[measurements(**one) for one, _ in row] for row in trials], [[faults for _, faults in row] for row in trials]
    )


def test_what_trials_show_counts_as_much_as_what_the_scene_shows():
    known = outlines(*[((1,), (0,), {"layout": ("T",)}) for _ in range(3)])
    shows, loses = ({"layout": ("T",)}, 0), ({"layout": ("straight",)}, 0)
    tried, rng = _tried(known, [[loses, loses], [shows, shows], [shows, loses]]), np.random.default_rng(0)
    assert {tried.draw(rng, check_attributes({"layout": "T"})) for _ in range(20)} == {1}
    assert {tried.draw(rng, check_attributes({"vehicles": 0})) for _ in range(40)} == {0, 1, 2}
    assert {known.draw(rng, check_attributes({"layout": "T"})) for _ in range(40)} == {0, 1, 2}


def test_of_many_scenes_those_with_fewest_faults_in_trials_are_drawn_for_a_request():
    known, rng = outlines(*[((1,), (0,), {"layout": ("T",)}) for _ in range(100)]), np.random.default_rng(0)
    tried = _tried(known, [[({"layout": ("T",)}, row % 2)] for row in range(100)])
    rows = {tried.draw(rng, check_attributes({"layout": "T"})) for _ in range(40)}
    assert len(rows) > 1 and not any(row % 2 for row in rows)
    assert {tried.draw(rng, {}) % 2 for _ in range(40)} == {0, 1}


def test_trials_do_not_count_for_parts_of_scenes():
    known = outlines(*[((1,), (0,), {"layout": ("T",)}) for _ in range(2)])
    tried, rng = _tried(known, [[({"layout": ("T",)}, 0)], [({}, 1)]]), np.random.default_rng(0)
    draws = {tried.draw(rng, check_attributes({"layout": "T"}), among=np.arange(2)) for _ in range(40)}
    assert draws == {0, 1}


@pytest.mark.parametrize("part", ["measured", "faults"])
def test_trials_are_read_from_files_or_refused(part):
    tried = _tried(outlines(*ROWS), [[({"gap_ahead": 5.55 + row}, row)] * 2 for row in range(3)])
    arrays, values = tried.arrays(), json.loads(json.dumps(tried.values))
    again = Outlines.from_files(arrays, values)
    assert again.values == tried.values and all(np.array_equal(again.arrays()[name], arrays[name]) for name in arrays)
    for broken in (arrays[f"trials.{part}"][1:], arrays[f"trials.{part}"].astype(np.float32)):
        with pytest.raises(ValueError, match=f"outlines: {part} of trials"):
            Outlines.from_files({**arrays, f"trials.{part}": broken}, values)
    beyond = arrays["trials.measured"] + np.int16(30_000)
    with pytest.raises(ValueError, match="outside values"):
        Outlines.from_files({**arrays, "trials.measured": beyond}, values)


def test_of_many_scenes_those_whose_agents_show_the_request_are_drawn():
    known, rng = outlines(*[((1,), (0, k % 2), {}) for k in range(100)]), np.random.default_rng(0)
    rows = {known.draw(rng, {"ahead": (1, None)}, count_misses=lambda kinds: kinds[:, 1]) for _ in range(40)}
    assert len(rows) > 1 and not any(row % 2 for row in rows)


def test_what_one_scene_does_not_show_is_named():
    known = outlines(*ROWS)
    assert known.missed_by(1, check_attributes({"layout": "straight", "vehicles": 2, "signal": "green"})) == {
        "layout",
        "signal",
    }


def test_draws_show_least_of_what_is_negative():
    assert _draws(request={"layout": "T"}, negative={"signal": "red"}) == {0}
    assert _draws(request={"signal": "red"}, negative={"signal": "red"}) == {1}


def test_draws_are_of_the_domain_and_nearest_in_numbers():
    assert _draws(domains=[0, 1, 1], domain=1) == {1, 2}
    assert _draws(domains=[0, 0, 0], domain=1) == {0, 1, 2}
    assert _draws(num_lanes=9) == {1}
    assert _draws(num_agents=1) == {2}
    assert _draws(request={"layout": "T"}, num_lanes=1) == {0}


def test_outlines_survive_files():
    known = outlines(*ROWS)
    arrays = {name: getattr(known, name) for name in ARRAYS}
    again = Outlines.from_files(arrays, {name: [_json(value) for value in known.values[name]] for name in known.values})
    request = {"layout": "T", "gap_ahead": (12, 13)}
    assert again.count_held(request).tolist() == known.count_held(request).tolist() == [2, 1, 0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"measured": np.full((3, len(ATTRIBUTES)), 50, np.int16)}, "measured points outside values"),
        ({"domains": np.zeros(2, np.int16)}, r"lanes has shape \(3, 4\)"),
        ({"agents": np.zeros((3, 2))}, "agents has shape"),
    ],
)
def test_parts_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(outlines(*ROWS), **change).check()


def test_outlines_of_another_table_are_refused():
    with pytest.raises(ValueError, match="another table of attributes"):
        Outlines.from_files({}, {"layout": []})


def _json(value):
    return list(value) if isinstance(value, tuple) else value


def test_draws_for_known_lanes_are_of_similar_lanes():
    """Kinds 0 to 3 are four directions: with the ego, to its left, against it, to its right."""
    rows = [((0, 0), (0,) * 3, {"vehicles": 2}), ((0, 2), (0,) * 3, {"vehicles": 2}), ((0, 2, 1), (0,), {})]
    known, rng = outlines(*rows), np.random.default_rng(0)
    assert {known.draw(rng, {}, lanes=np.array([2, 0]), num_agents=3) for _ in range(20)} == {1}
    assert {known.draw(rng, {}, lanes=np.array([2, 0]), num_agents=1) for _ in range(20)} == {1}
    assert {known.draw(rng, {}, lanes=np.array([2, 0, 1]), num_agents=3) for _ in range(20)} == {2}
    assert {known.draw(rng, check_attributes({"vehicles": 2}), lanes=np.array([2, 0, 1])) for _ in range(20)} == {1}
