"""Numbers of agents by kind: the table of the training's scenes, and draws from it that fulfill a request."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.language.attributes.contradictions import least_numbers
from scjax.models.counts.kinds import KINDS, draw_kind_counts, kind_table

NOBODY = np.zeros(len(KINDS), np.int32)
ROWS = [(3, 0, 0, 0, 0)] * 4 + [(5, 2, 0, 0, 1), (5, 0, 1, 0, 0), (1, 6, 0, 3, 0), (12, 1, 0, 0, 4)]
TABLE = kind_table([dict(zip(KINDS, row, strict=True)) for row in ROWS])
TOTALS = np.full(20, 0.05)


def _least(request):
    least = least_numbers(request)
    return np.array([least.get(name, 0) for name in KINDS], np.int32)


def _draws(request, *, number=40, totals=TOTALS, least=NOBODY, most=61, **options):
    rng, least = np.random.default_rng(0), np.maximum(least, _least(request))
    drawn = [draw_kind_counts(rng, TABLE, totals, request, least=least, most=most, **options) for _ in range(number)]
    return {tuple(row.tolist()) for row in drawn}


def test_table_has_a_row_for_every_different_scene():
    assert TABLE[0].tolist() == [3, 0, 0, 0, 0, 4]
    assert TABLE[:, -1].sum() == len(ROWS) and len(TABLE) == 5
    assert kind_table([]).shape == (0, len(KINDS) + 1)


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        ({"vehicles": (5, 5)}, {ROWS[4], ROWS[5]}),
        ({"vehicles": (4, None), "pedestrians": (0, 0)}, {ROWS[5]}),
        ({"large": (1, 2)}, {ROWS[4]}),
        ({"compare": ("pedestrians > vehicles",)}, {ROWS[6]}),
        ({"parked": (6, None)}, {ROWS[7]}),
        ({"event": ("work-zone",)}, {ROWS[6]}),
        ({"layout": "T"}, set(ROWS)),
    ],
)
def test_draws_fulfill_the_request(request_, expected):
    assert _draws(request_, number=200) == expected


def test_draws_follow_the_probabilities_of_the_total():
    totals = np.zeros(20)
    totals[4] = 1.0  # three agents besides the ego
    assert _draws({}, totals=totals) == {ROWS[0]}
    assert _draws({"vehicles": (5, None)}, totals=totals) == {ROWS[4], ROWS[5], ROWS[7]}  # none of three: any


def test_draws_keep_what_is_there_and_the_total():
    least = np.array([2, 1, 0, 0, 0])
    assert _draws({}, least=least) == {ROWS[4], ROWS[7]}
    assert _draws({}, total=8) == {ROWS[4]}
    assert _draws({"cyclists": (1, 1)}, total=7) == {ROWS[5]}
    rng = np.random.default_rng(0)
    assert draw_kind_counts(rng, TABLE, TOTALS, {}, least=NOBODY, most=61, total=50) is None


def test_requests_that_no_scene_fulfills_get_the_least():
    request = {"vehicles": (40, 40), "pedestrians": (2, None), "large": (50, None)}
    assert _draws(request) == {(50, 2, 0, 0, 50)}
    assert _draws(request, most=31) == {(30, 0, 0, 0, 30)}


def test_parts_and_events_need_agents():
    request = {"ahead": (2, 3), "stopped": (4, None), "pedestrians_on_road": (1, 1), "event": ("work-zone", "cut-in")}
    assert _least(request).tolist() == [4, 1, 0, 3, 0]
    assert _least({"queue": True}).tolist() == [3, 0, 0, 0, 0]
    assert _least({"parked": (2, 2)}).tolist() == [2, 0, 0, 0, 0]
    assert not _least({"queue": False, "vehicles": (0, 5)}).any()
