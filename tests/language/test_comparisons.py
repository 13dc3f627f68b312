"""Comparisons at numbers: what wordings of all languages state."""

from __future__ import annotations

import numpy as np
import pytest

from scjax.language.reader.comparisons import compared_bounds
from scjax.language.reader.targets import LEVELS, NAMED, RANGES, VALUES, read_outputs


@pytest.mark.parametrize(
    ("text", "bounds"),
    [
        ("fewer than three vehicles", [(0, 2)]),
        ("no fewer than three vehicles", [(3, None)]),
        ("under ten vehicles but over five", [(0, 9), (6, None)]),
        ("three cars at most, 4 or more bikes", [(0, 3), (4, None)]),
        ("exactly 5 cars, 5 bikes", [(5, 5)]),
        ("around fifteen vehicles, about 20", [(13, 17), (17, 23)]),
        ("at least a dozen vehicles", [(12, None)]),
        (">= 10 veh, max. 2 peds", [(10, None), (0, 2)]),
        ("mindestens drei Autos, höchstens zwei Lkw", [(3, None), (0, 2)]),
        ("menos de cuatro coches", [(0, 3)]),
        ("3台以上の車", [(3, None)]),
        ("three cars wait, two leave", []),
        ("the bus stops at leastways 3", []),
        ("", []),
    ],
)
def test_comparisons_state_ranges(text, bounds):
    assert list(compared_bounds(text)) == bounds


def test_comparisons_change_ranges_and_add_none():
    named, ends = np.full((len(NAMED), VALUES), -9.0), np.full((len(RANGES), 2, LEVELS), -9.0)
    named[:, 0], ends[:, :, 0] = 9.0, 9.0
    assert "vehicles" not in read_outputs(named, ends, [3], [(0, 2)]).request
    row = next(place for place, one in enumerate(RANGES) if one.name == "vehicles")
    ends[row, 1] = -9.0
    ends[row, 1, [3, 4]] = 2.0, 3.0  # 0 to 2, 0 to 3
    assert read_outputs(named, ends, [3]).request["vehicles"] == (0, 3)
    assert read_outputs(named, ends, [3], [(0, 2)]).request["vehicles"] == (0, 2)
